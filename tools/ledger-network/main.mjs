// Starts a network of execution clients on this machine: see `scripts/ledger-network --help`.
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { parseArgs } from "node:util";

import { Network } from "./network.mjs";

const HELP = `Starts a network of Ethereum nodes on this machine, one for each domain, and prints their WebSockets; Ctrl-C ends it, and
nothing of it is left. The nodes are real execution clients (EthereumJS), which execute each other's blocks. One program has them
make these in turn: there is no consensus, and nobody holds out against a node that lies.

  scripts/ledger-network [OPTIONS] [-- COMMAND...]

  --nodes N                how many, one per domain, 1 to 16 [4]
  --block-period SECONDS   from block to block, 0.1 to 3600 [5]
  --fund ACCOUNT           an account with money, any number of times [those of the operators of tests]
  --help

COMMAND runs on it, and the network ends with it. It has the nodes' WebSockets in COTORRA_TEST_LEDGER, with commas between, and in
COTORRA_LEDGER, COTORRA_LEDGER_KEYS and COTORRA_LEDGER_NETWORK what \`cotorra-lab experiment federation\` wants to know.

  scripts/ledger-network --block-period 1
  scripts/ledger-network --block-period 1 -- cotorra-lab experiment federation --emulate
`;

/** The accounts of the keys 0101…01, 0202…02, 0303…03 and 6363…63, which the tests of the ledger use. */
const OPERATORS = [
  "0x1a642f0e3c3af545e7acbd38b07251b3990914f1",
  "0x5050a4f4b3f9338c3472dcc01a87c76a144b3c9c",
  "0x3325a78425f17a7e487eb5666b2bfd93abb06c70",
  "0xfc5e22c7be9d60db4bbe0345709734a815fb0e40",
];

function options() {
  const wrong = (reason) => {
    console.error(`${reason}; see --help`);
    process.exit(2);
  };
  const split = process.argv.indexOf("--");
  const own = process.argv.slice(2, split < 0 ? undefined : split);
  const command = split < 0 ? [] : process.argv.slice(split + 1);
  const text = { type: "string" };
  const known = { nodes: text, "block-period": text, fund: { ...text, multiple: true }, client: text, keys: text };
  let values;
  try {
    ({ values } = parseArgs({ args: own, options: { ...known, help: { type: "boolean", short: "h" } } }));
  } catch (error) {
    wrong(error.message);
  }
  if (values.help) {
    console.log(HELP);
    process.exit();
  }
  const [nodes, period] = [Number(values.nodes ?? 4), Number(values["block-period"] ?? 5)];
  if (!Number.isInteger(nodes) || nodes < 1 || nodes > 16) wrong("--nodes is a number from 1 to 16");
  if (!(period >= 0.1 && period <= 3600)) wrong("--block-period is from 0.1 to 3600 seconds");
  const fund = values.fund ?? OPERATORS;
  const isAccount = (account) => /^0x[0-9a-fA-F]{40}$/.test(account);
  if (!fund.every(isAccount)) wrong("--fund is an account, 0x and 40 hexadecimal digits");
  return { nodes, period, fund, client: values.client, keys: resolve(values.keys), command };
}

/** The accounts of the key stores in a folder. */
function accounts(folder) {
  const stores = readdirSync(folder).filter((name) => name.endsWith(".json"));
  const address = (name) => JSON.parse(readFileSync(join(folder, name), "utf8")).address;
  return stores.map((name) => `0x${address(name).replace(/^0x/, "")}`);
}

const { nodes, period, fund, client, keys, command } = options();
const folder = mkdtempSync(join(tmpdir(), "cotorra-ledger-"));
const network = new Network({ nodes, client, folder, funded: [...fund, ...accounts(keys)] });
const ending = new AbortController();
const { signal } = ending;
let running;

async function end(status) {
  ending.abort();
  await network.stop();
  rmSync(folder, { recursive: true, force: true, maxRetries: 10 });
  process.exit(status);
}

// A command hears of Ctrl-C itself, and the network ends with it.
process.on("SIGINT", () => running || end(0));
for (const name of ["SIGTERM", "SIGHUP"]) process.on(name, () => (running ? running.kill(name) : end(0)));

async function makeBlocks() {
  let next = Date.now();
  while (!signal.aborted) {
    if (!(await network.makeBlock())) continue;
    next = Math.max(Date.now(), next + 1000 * period);
    await sleep(next - Date.now(), undefined, { signal }).catch(() => {});
  }
}

function run(urls) {
  const others = urls.slice(1).map((url, index) => `domain-${index + 2}=${url}`);
  const variables = {
    COTORRA_TEST_LEDGER: urls.join(","),
    // Whoever has no node of its own uses the first domain's.
    COTORRA_LEDGER: [urls[0], ...others].join(","),
    COTORRA_LEDGER_KEYS: keys,
    COTORRA_LEDGER_NETWORK: `a network of ${nodes} nodes that make blocks in turn (no consensus)`,
  };
  running = spawn(command[0], command.slice(1), { stdio: "inherit", env: { ...process.env, ...variables } });
  running.on("error", (error) => {
    console.error(`${command[0]}: ${error.message}`);
    end(127);
  });
  running.on("exit", (status, by) => {
    if (by) console.error(`${command.join(" ")}: ended by ${by}`);
    end(status ?? 1);
  });
}

try {
  console.error(`starting ${nodes} execution clients …`);
  await network.start();
  while (!(await network.makeBlock()));
  console.log(network.urls.join("\n"));
  console.error(`logs are in ${folder}; Ctrl-C ends it`);
  if (command.length > 0) run(network.urls);
  await makeBlocks();
} catch (error) {
  if (!signal.aborted) {
    // Its logs tell why.
    running?.removeAllListeners("exit").kill();
    await network.stop();
    console.error(`${error.message}; logs are in ${folder}`);
    process.exit(1);
  }
}
