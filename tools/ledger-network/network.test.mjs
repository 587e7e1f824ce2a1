// Networks of real execution clients: they agree, go on without one, take it back, and start again with what they had. Nothing here
// waits for a time: blocks are made one by one.
//
//   node --test tools/ledger-network/network.test.mjs
import assert from "node:assert/strict";
import { mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import test from "node:test";
import { fileURLToPath } from "node:url";

import { Network } from "./network.mjs";

const client = fileURLToPath(
  new URL("../../contracts/node_modules/@ethereumjs/client/dist/esm/bin/cli.js", import.meta.url),
);
const library = createRequire(client);
const { createFeeMarket1559Tx } = library("@ethereumjs/tx");
const { createCustomCommon, Mainnet } = library("@ethereumjs/common");
const { createAddressFromPrivateKey } = library("@ethereumjs/util");

const KEY = new Uint8Array(32).fill(1);
const ACCOUNT = createAddressFromPrivateKey(KEY).toString();
const GWEI = 1_000_000_000n;

/** A network for the time of a test. */
async function network(t, nodes) {
  const folder = mkdtempSync(join(tmpdir(), "cotorra-ledger-test-"));
  const made = new Network({ nodes, client, folder, funded: [ACCOUNT], log: (line) => t.diagnostic(line) });
  t.after(async () => {
    await made.stop();
    rmSync(folder, { recursive: true, force: true, maxRetries: 10 });
  });
  await made.start();
  return made;
}

/** Makes so many blocks; returns the last. */
async function blocks(network, count) {
  const wanted = network.height + count;
  while (network.height < wanted) await network.makeBlock();
  return network.blocks.at(-1);
}

/** A payment of nothing. */
function payment(nonce, tip) {
  const common = createCustomCommon({ chainId: 7701 }, Mainnet, { hardfork: "shanghai" });
  const fees = { maxFeePerGas: tip + 100n, maxPriorityFeePerGas: tip, gasLimit: 21_000 };
  const signed = createFeeMarket1559Tx({ nonce, to: ACCOUNT, ...fees }, { common }).sign(KEY);
  return `0x${Buffer.from(signed.serialize()).toString("hex")}`;
}

const nonce = async (node) => Number(await node.rpc("eth_getTransactionCount", ACCOUNT, "latest"));

async function agree(network) {
  for (const node of network.nodes) {
    assert.equal(node.height, network.height, node.name);
    for (const { blockNumber, blockHash } of network.blocks) {
      assert.equal((await node.rpc("eth_getBlockByNumber", blockNumber, false)).hash, blockHash, node.name);
    }
  }
}

/** Makes blocks until a node has all of them; so many at most. */
async function untilBack(network, node, most) {
  for (let count = 0; node.height !== network.height; count++) {
    assert.ok(count < most, `${node.name} does not catch up`);
    await blocks(network, 1);
    await node.following;
  }
}

test("four nodes agree, go on without one, and take it back", async (t) => {
  const four = await network(t, 4);
  await blocks(four, 5);
  await agree(four);

  const [first, , , last] = four.nodes;
  await last.kill();
  await blocks(four, 5);
  assert.equal(first.height, 10);

  last.start();
  while (last.height === undefined) await four.makeBlock();
  await untilBack(four, last, 50);
  await agree(four);

  // All at once, as when the power fails for all.
  await Promise.all(four.nodes.map((node) => node.kill()));
  for (const node of four.nodes) node.start();
  await blocks(four, 3);
  for (const node of four.nodes) await untilBack(four, node, 50);
  await agree(four);
});

test("a transaction given to one node is in the next block, whoever makes it", async (t) => {
  const three = await network(t, 3);
  await blocks(three, 1);
  for (let number = 0; number < 6; number++) {
    await three.nodes[0].rpc("eth_sendRawTransaction", payment(number, GWEI));
    const { transactions } = await blocks(three, 1);
    assert.equal(transactions.length, 1);
  }
});

test("a transaction whose place was taken too late holds nobody up", async (t) => {
  const one = await network(t, 1);
  await blocks(one, 1);
  const [node] = one.nodes;
  await node.rpc("eth_sendRawTransaction", payment(0, GWEI));
  // While a block with it is made, its owner offers more for it.
  const { blockHash, timestamp } = one.blocks.at(-1);
  const attributes = { timestamp: `0x${(Number(timestamp) + 1).toString(16)}`, prevRandao: blockHash };
  const rest = { suggestedFeeRecipient: ACCOUNT, withdrawals: [] };
  const id = await node.adopt(blockHash, { ...attributes, ...rest });
  await node.rpc("eth_sendRawTransaction", payment(0, 2n * GWEI));
  const { executionPayload: block } = await node.engine("engine_getPayloadV2", id);
  assert.equal(block.transactions.length, 1);
  assert.equal(await node.execute(block), "VALID");
  await node.adopt(block.blockHash);
  one.blocks.push(block);
  node.height = one.height;
  assert.equal(await nonce(node), 1);

  await node.rpc("eth_sendRawTransaction", payment(1, GWEI));
  await blocks(one, 3);
  assert.equal(await nonce(node), 2);
});
