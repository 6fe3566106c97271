// The line to the page server: JSON texts both ways, one binary message a shown frame; comes back by itself.

const RETRY_MS = [300, 1000, 2000, 4000];

export class Connection {
  #socket = null;
  #tries = 0;
  #ended = false;

  /** `on` holds the handlers open(), text(message), frame(header, payloads) and closed(reason, retrying). */
  constructor(url, on) {
    this.url = url;
    this.on = on;
  }

  open() {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.#tries = 0;
      this.on.open();
    };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") this.on.text(JSON.parse(event.data));
      else this.on.frame(...unpack(event.data));
    };
    socket.onclose = (event) => {
      this.#socket = null;
      if (this.#ended) return;
      const refused = event.code === 1008;
      this.on.closed(event.reason, !refused);
      if (!refused) setTimeout(() => this.open(), RETRY_MS[Math.min(this.#tries++, RETRY_MS.length - 1)]);
    };
    this.#socket = socket;
  }

  send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  end() {
    this.#ended = true;
    this.#socket?.close();
  }
}

/** Header and payloads of a binary message: header length (u32, big-endian), header, then what the header lists. */
function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  const next = (item) => {
    const bytes = new Uint8Array(buffer, at, item.bytes);
    at += item.bytes;
    return bytes;
  };
  return [header, { pictures: header.pictures.map(next), grids: header.overlays.grids.map(next) }];
}
