import assert from "node:assert/strict";
import { test } from "node:test";
import { crc32 } from "../../src/bytes/crc32.ts";
import type { Intrinsics, Pose } from "../../src/seam.ts";
import { decode } from "../../src/wire/encoding.ts";
import type { Control, HeldTile, Hello, WireSample } from "../../src/wire/messages.ts";
import { ClientSession, type SessionEvent } from "../../src/wire/session.ts";
import { fromHex, hex, vectors } from "./vectors.ts";

type Step = Record<string, unknown> & { op: string; now: number; state: string };

function helloOf(fields: Record<string, unknown>): Hello {
  const i = fields["intrinsics"] as Record<string, number>;
  const intrinsics: Intrinsics = {
    widthPx: i["width_px"]!, heightPx: i["height_px"]!, fxPx: i["fx_px"]!, fyPx: i["fy_px"]!, cxPx: i["cx_px"]!, cyPx: i["cy_px"]!,
  };
  const inventory = fromHex(fields["inventory"] as string);
  return { type: "hello", ...fields, intrinsics, pose: fields["pose"] as Pose, inventory } as unknown as Hello;
}

/** An event as the Python side writes it down. */
function told(event: SessionEvent): Record<string, unknown> {
  if (event.type === "blob") return { type: "blob", name: event.name, crc: crc32(event.data) };
  if (event.type === "closed") return { type: "closed", code: event.code };
  const out: Record<string, unknown> = { type: event.type };
  if ("message" in event) {
    const { type: _type, ...fields } = event.message as unknown as Record<string, unknown>;
    const simple = Object.entries(fields).filter(([, value]) => typeof value === "string" || typeof value === "boolean" || Number.isInteger(value));
    out["fields"] = Object.fromEntries(simple);
  }
  if ("payload" in event) out["payload"] = crc32(event.payload);
  return out;
}

/** Of messages that end a breach only the kind counts: the sentence is each program's own. */
function sameMessages(found: Uint8Array[], wanted: string[], breached: boolean): void {
  const shorten = (data: Uint8Array): string => {
    const { message } = decode(data);
    return breached && message.type === "bye" ? "bye" : hex(data);
  };
  assert.deepEqual(found.map(shorten), wanted.map((data) => shorten(fromHex(data))));
}

function perform(session: ClientSession, step: Step, breached: boolean): void {
  const { now } = step;
  switch (step.op) {
    case "hello": return session.hello(helloOf(step["message"] as Record<string, unknown>), now);
    case "receive": return session.receive(fromHex(step["data"] as string), now);
    case "poses": return session.sendPoses(step["samples"] as WireSample[], now, step["cadence"] as number);
    case "control": return session.control({ type: "control", ...(step["message"] as object) } as Control, now);
    case "keyframe": return session.requestKeyframe(step["seq"] as number, now);
    case "evictions": return session.reportEvictions(step["tiles"] as HeldTile[]);
    case "handle": return session.handleTimer(now);
    case "lost": return session.connectionLost(step["reason"] as string);
    case "bye": return session.bye(step["reason"] as string, now);
    case "timer": return assert.equal(session.nextTimerUs() ?? null, step["due"]);
    case "data": {
      session.bufferedBytes = step["buffered"] as number;
      return sameMessages(session.dataToSend(now), step["out"] as string[], breached);
    }
    case "event": {
      const event = session.nextEvent();
      assert.equal(session.damagedPackets, step["damaged"]);
      return assert.deepEqual(event ? reals(told(event)) : null, step["event"] && reals(step["event"] as Record<string, unknown>));
    }
    default: assert.fail(step.op);
  }
}

/** Without the fields that are floats in Python, which JSON writes alike where they are whole. */
function reals(event: Record<string, unknown>): Record<string, unknown> {
  const { knee: _knee, error: _error, ...fields } = (event["fields"] ?? {}) as Record<string, unknown>;
  return { ...event, fields };
}

test("a session answers, step by step, as Python's did", () => {
  for (const [i, steps] of vectors<Step[][]>("transcripts").entries()) {
    const session = new ClientSession(0);
    const breach = steps.some((step) => ["malformed", "unexpected"].includes(((step["event"] as { code?: string } | null)?.code) ?? ""));
    for (const [at, step] of steps.entries()) {
      try {
        perform(session, step, breach);
        assert.equal(session.state, step.state);
      } catch (error) {
        throw new Error(`transcript ${i}, step ${at}: ${step.op}`, { cause: error });
      }
    }
  }
});
