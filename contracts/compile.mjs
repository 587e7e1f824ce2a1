// Compiles with the solc that package-lock.json pins: Federation.sol to Federation.json, its ABI and bytecode, and what
// the tests attack it with.
//
//   npm install --prefix contracts --no-save   once
//   node contracts/compile.mjs                writes the artefacts
//   node contracts/compile.mjs --check        fails if an artefact is not what its source compiles to
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";

const solc = createRequire(import.meta.url)("solc");
const file = (name) => new URL(name, import.meta.url);

// The oldest instructions in use: the contract then runs on any network that has had an upgrade since 2022.
const settings = {
  evmVersion: "paris",
  optimizer: { enabled: true, runs: 1000 },
  outputSelection: { "*": { "*": ["abi", "evm.bytecode.object"] } },
};

function compile(name) {
  const sources = { [name]: { content: readFileSync(file(name), "utf8") } };
  const output = JSON.parse(solc.compile(JSON.stringify({ language: "Solidity", sources, settings })));
  if (output.errors?.length) {
    for (const { formattedMessage } of output.errors) console.error(formattedMessage);
    process.exit(1);
  }
  return output.contracts[name];
}

function write(name, artefact) {
  const text = `${JSON.stringify(artefact, null, 1)}\n`;
  if (!process.argv.includes("--check")) {
    writeFileSync(file(name), text);
  } else if (readFileSync(file(name), "utf8") !== text) {
    console.error(`contracts/${name} is not what its source compiles to: run node contracts/compile.mjs`);
    process.exitCode = 1;
  }
}

const bytecode = ({ evm }) => `0x${evm.bytecode.object}`;
const { Federation } = compile("Federation.sol");
const compiler = { name: "solc", version: solc.version(), evmVersion: settings.evmVersion, optimizer: settings.optimizer };
write("Federation.json", { contractName: "Federation", compiler, abi: Federation.abi, bytecode: bytecode(Federation) });

const { Reentrant, Unpayable } = compile("Attackers.sol");
write("Attackers.json", { Reentrant: bytecode(Reentrant), Unpayable: bytecode(Unpayable) });
