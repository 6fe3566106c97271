// node reader.mjs INDEX_MJS FILE REPEATS: how long splat-transform's own reader takes for FILE (.sog or .spz), read from
// memory; prints the times in milliseconds as JSON, after one run that warms up.
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [index, file, repeats] = process.argv.slice(2);
const { MemoryReadFileSystem, getInputFormat, logger, readFile } = await import(pathToFileURL(index));
logger.setRenderer({ handle() {} });
const bytes = readFileSync(file), times = [];
const name = file.endsWith('.sog') ? 'scene.sog' : 'scene.spz';
for (let run = 0; run <= Number(repeats); run++) {
  const fileSystem = new MemoryReadFileSystem();
  fileSystem.set(name, bytes);
  const start = performance.now();
  await readFile({ filename: name, inputFormat: getInputFormat(name), options: {}, params: [], fileSystem });
  if (run) times.push(performance.now() - start);
}
console.log(JSON.stringify(times));
