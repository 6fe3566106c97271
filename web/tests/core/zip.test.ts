/** Frames that are dropped together travel as an archive, which Python reads (`tests/web/page/test_zip.py`). */

import { writeFileSync } from "node:fs";
import { join } from "node:path";
import test from "node:test";
import { zipped } from "../../src/page/zip.ts";

test("files become an archive", async () => {
  const files = [2, 10, 1].map((number) => new File([new Uint8Array(number * 1000).fill(number)], `träume ${number}.ply`));
  const archive = await zipped(files);
  writeFileSync(join(process.env["CAGS_VECTORS"]!, "page.zip"), new Uint8Array(await archive.arrayBuffer()));
});
