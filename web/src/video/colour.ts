/** YCbCr planes to RGB: BT.709 matrix, limited range, chroma sited at the block's centre, as `cags_common.video.colour`. */

const f = Math.fround;

/** Rows of the matrix that takes YCbCr codes and 1 to RGB in [0, 1], single floats. */
const TO_RGB = rgbMatrix();

function rgbMatrix(): Float32Array {
  const [kr, kb] = [0.2126, 0.0722];
  const kg = 1 - kr - kb;
  const y = 1 / 219;
  const red = (2 * (1 - kr)) / 224;
  const blue = (2 * (1 - kb)) / 224;
  const greenCb = (-blue * kb) / kg;
  const greenCr = (-red * kr) / kg;
  return Float32Array.of(
    ...[y, 0, red, -16 * y - 128 * red],
    ...[y, greenCb, greenCr, -16 * y - 128 * (greenCb + greenCr)],
    ...[y, blue, 0, -16 * y - 128 * blue],
  );
}

/** Where red, green and blue lie in the four bytes of a pixel. */
const PACKED = { RGBA: [0, 1, 2], RGBX: [0, 1, 2], BGRA: [2, 1, 0], BGRX: [2, 1, 0] } as const;

/** One picture as a browser hands it out; strides are in bytes. */
interface Pixels {
  readonly width: number;
  readonly height: number;
  readonly data: Uint8Array;
  readonly layout: readonly { readonly offset: number; readonly stride: number }[];
}

/** Y, Cb and Cr, each in a plane of its own, or the last two in one. */
export interface Planes extends Pixels {
  readonly format: "I444" | "I420" | "NV12";
}

/** RGB that the browser made of the planes itself, as Firefox does. */
export interface Packed extends Pixels {
  readonly format: keyof typeof PACKED;
}

export function isPacked(format: string | null): format is Packed["format"] {
  return format !== null && Object.hasOwn(PACKED, format);
}

/** RGB [h, w, 3] in [0, 1]. */
export function rgbOfPlanes(planes: Planes): Float32Array<ArrayBuffer> {
  const { width, height, data, layout } = planes;
  const [cb, cr] = planes.format === "I444" ? [fullPlane(planes, 1), fullPlane(planes, 2)] : doubledPlanes(planes);
  const out = new Float32Array(3 * width * height);
  const m = TO_RGB;
  for (let row = 0, i = 0; row < height; row++) {
    const luma = layout[0].offset + row * layout[0].stride;
    for (let column = 0; column < width; column++, i++) {
      const [y, b, r] = [data[luma + column], cb[i], cr[i]];
      for (let c = 0; c < 3; c++) {
        const k = 4 * c; // each product is added and rounded once, as fused instructions do
        const value = f(y * m[k] + f(b * m[k + 1] + f(r * m[k + 2] + m[k + 3])));
        out[3 * i + c] = value < 0 ? 0 : value > 1 ? 1 : value;
      }
    }
  }
  return out;
}

/** RGB [h, w, 3] in [0, 1]. */
export function rgbOfPacked({ width, height, data, layout, format }: Packed): Float32Array<ArrayBuffer> {
  const out = new Float32Array(3 * width * height);
  const { offset, stride } = layout[0];
  const order = PACKED[format];
  for (let row = 0, i = 0; row < height; row++) {
    const from = offset + row * stride;
    for (let at = from; at < from + 4 * width; at += 4) for (const channel of order) out[i++] = data[at + channel] / 255;
  }
  return out;
}

function fullPlane({ width, height, data, layout }: Planes, index: number): Float32Array {
  const out = new Float32Array(width * height);
  for (let row = 0; row < height; row++) {
    const from = layout[index].offset + row * layout[index].stride;
    out.set(data.subarray(from, from + width), row * width);
  }
  return out;
}

/** Cb and Cr of a picture with one sample a 2x2 block, bilinear with half-pixel centres. */
function doubledPlanes({ width, height, data, layout, format }: Planes): [Float32Array, Float32Array] {
  const step = format === "NV12" ? 2 : 1;
  const make = (index: number): Float32Array => {
    const { offset, stride } = format === "NV12" ? layout[1] : layout[index];
    const first = offset + (format === "NV12" ? index - 1 : 0);
    return doubled(width, height, (row, column) => data[first + row * stride + step * column]);
  };
  return [make(1), make(2)];
}

function doubled(width: number, height: number, at: (row: number, column: number) => number): Float32Array {
  const [rows, columns] = [height / 2, width / 2];
  const out = new Float32Array(width * height);
  for (let y = 0; y < height; y++) {
    const [top, bottom, down] = neighbours(y, rows);
    for (let x = 0; x < width; x++) {
      const [left, right, across] = neighbours(x, columns);
      const upper = at(top, left) * (1 - across) + at(top, right) * across;
      const lower = at(bottom, left) * (1 - across) + at(bottom, right) * across;
      out[y * width + x] = upper * (1 - down) + lower * down; // quarters of small integers: exact
    }
  }
  return out;
}

/** The two samples around a pixel of a picture that is twice as large, and the weight of the second. */
function neighbours(pixel: number, count: number): [number, number, number] {
  const place = pixel / 2 - 0.25;
  const low = Math.floor(place);
  return [Math.max(low, 0), Math.min(low + 1, count - 1), place - low];
}
