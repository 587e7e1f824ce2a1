// Preloaded into an execution client (EthereumJS 0.10): corrects what makes a network of several stand still, or opens it to others.
import { Server } from "node:net";
import { argv } from "node:process";
import { pathToFileURL } from "node:url";

// Some of its ports would be open to all machines, and everybody has the keys of a network of trials.
const { listen } = Server.prototype;
Server.prototype.listen = function (port, host, ...rest) {
  const isOpen = typeof host !== "string" || host === "0.0.0.0" || host === "::";
  if (typeof port !== "number" || !isOpen) return listen.call(this, port, host, ...rest);
  if (typeof host !== "string") rest.unshift(host);
  return listen.call(this, port, "127.0.0.1", ...rest);
};

const part = (path) => import(new URL(`../src/${path}`, pathToFileURL(argv[1])));

// Blocks with more than 200 transactions it would leave to a synchronization that there is not.
const { Config } = await part("config.js");
Config.ENGINE_NEWPAYLOAD_MAX_TXS_EXECUTE = Infinity;

// A block takes its transactions out of the pool by their hashes. What stays is one that took the place of another for a higher fee
// while that one went into a block, and one that came to the pool just after the block that has it. Its nonce is used, it can be in
// no block, and the pool gives no other transaction of its account to a block before it forgets this one, 20 to 40 minutes later.
const { TxPool } = await part("service/txpool.js");
const { txsByPriceAndNonce } = TxPool.prototype;
TxPool.prototype.txsByPriceAndNonce = async function (...options) {
  const { chain, execution } = this.service;
  const head = await chain.getCanonicalHeadHeader();
  const vm = await execution.vm.shallowCopy();
  await vm.stateManager.setStateRoot(head.stateRoot);
  for (const waiting of [...this.pool.values()]) {
    const account = await vm.stateManager.getAccount(waiting[0].tx.getSenderAddress());
    const used = waiting.filter(({ tx }) => tx.nonce < (account?.nonce ?? 0n));
    used.forEach(({ tx, hash }) => this.removeByHash(hash, tx));
  }
  return txsByPriceAndNonce.apply(this, options);
};

// It ends with whoever started it, however that ended.
process.on("disconnect", () => process.exit());
