// Runs a program for WebAssembly (wasm32-wasip1) with the WASI of Node.js. The cpu tracer's tests use it.
//
//   node scripts/run_wasi.mjs PROGRAM.wasm [ARGUMENT…]

import { readFile } from 'node:fs/promises';
import { argv, env } from 'node:process';
import { WASI } from 'node:wasi';

const wasi = new WASI({ version: 'preview1', args: argv.slice(2), env });
const program = await WebAssembly.compile(await readFile(argv[2]));
process.exitCode = wasi.start(await WebAssembly.instantiate(program, wasi.getImportObject()));
