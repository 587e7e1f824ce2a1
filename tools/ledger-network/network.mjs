// Several execution clients (EthereumJS) on this machine, and what has them make blocks: one after the other makes one, and all
// execute it, by the Engine API. Nobody votes: one coordinator says what the chain is.
import { spawn } from "node:child_process";
import { createHmac, randomBytes } from "node:crypto";
import { openSync, realpathSync, writeFileSync } from "node:fs";
import http from "node:http";
import { createRequire } from "node:module";
import net from "node:net";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";

const CHAIN = 7701;
const ZERO = `0x${"0".repeat(64)}`;
/** A node that says nothing for so long is away: the others go on without it, and it gets twice as long the next time. With a limit
 * that stays, a node that takes longer for the transactions that wait makes no block ever again. */
const PATIENCE_MS = 30_000;
/** Between two attempts. */
const RETRY_MS = 100;
/** Below the ports that the kernel hands out. */
const PORTS = [10_000, 32_000];
/** JSON-RPC over HTTP and over WebSocket, the Engine API over both, devp2p. */
const PORTS_EACH = 5;

/** A node says no. */
class Refused extends Error {}

/** One execution client. */
class Node {
  /** The number of its last block; undefined while that is not known. */
  height = undefined;
  /** The hash of the block that it executed last. */
  executed = undefined;
  following = undefined;
  patience = PATIENCE_MS;

  constructor(network, name, ports) {
    Object.assign(this, { network, name, ports });
  }

  get url() {
    return `ws://127.0.0.1:${this.ports[1]}`;
  }

  start() {
    const { client, folder } = this.network;
    const log = openSync(join(folder, `${this.name}.log`), "a");
    const [rpc, ws, engine, wsEngine, p2p] = this.ports;
    const options = {
      ...{ dataDir: join(folder, this.name), gethGenesis: join(folder, "genesis.json"), jwtSecret: join(folder, "jwt") },
      ...{ rpcPort: rpc, wsPort: ws, rpcEnginePort: engine, wsEnginePort: wsEngine, port: p2p, logLevel: "warn" },
    };
    const flags = ["isSingleNode", "saveReceipts", "no-logFile", "rpc", "ws", "rpcEngine"];
    const corrections = new URL("corrections.mjs", import.meta.url).href;
    const valued = Object.entries(options).flatMap(([name, value]) => [`--${name}`, `${value}`]);
    const all = ["--import", corrections, client, ...flags.map((flag) => `--${flag}`), ...valued];
    // In a group of its own: Ctrl-C at the terminal is for whoever started the network.
    const child = spawn("node", all, { cwd: folder, detached: true, stdio: ["ignore", log, log, "ipc"] });
    this.child = child;
    this.ended = new Promise((done) => {
      child.once("error", done);
      child.once("exit", done);
    }).then(() => {
      this.child = this.height = undefined;
    });
  }

  /** Ends it as a power failure would. */
  async kill() {
    this.child?.kill("SIGKILL");
    await this.ended;
  }

  post(port, method, params, headers) {
    const body = JSON.stringify({ jsonrpc: "2.0", id: 1, method, params });
    return new Promise((resolve, reject) => {
      const options = { host: "127.0.0.1", port, method: "POST", agent: false };
      const request = http.request({ ...options, headers: { "content-type": "application/json", ...headers } }, (answer) => {
        const parts = [];
        answer.on("data", (part) => parts.push(part)).on("error", reject);
        answer.on("end", () => {
          try {
            const { result, error } = JSON.parse(Buffer.concat(parts));
            if (error) reject(new Refused(`${this.name} refuses ${method}: ${error.message}`));
            else resolve(result);
          } catch {
            reject(new Error(`${this.name} answers ${method} with what is none`));
          }
        });
      });
      request.setTimeout(this.patience, () => {
        this.patience *= 2;
        request.destroy(new Error(`${this.name} does not answer ${method}`));
      });
      request.on("error", reject).end(body);
    });
  }

  rpc(method, ...params) {
    return this.post(this.ports[0], method, params);
  }

  engine(method, ...params) {
    return this.post(this.ports[2], method, params, { authorization: `Bearer ${token(this.network.secret)}` });
  }

  /** Has it execute a block: VALID, INVALID or, while it does not know the parent or is busy, something else. */
  async execute(block) {
    if (this.executed === block.blockHash) return "VALID";
    const { status } = await this.engine("engine_newPayloadV2", block);
    if (status === "VALID") this.executed = block.blockHash;
    return status;
  }

  /** Makes a block the last; with attributes it begins to make the next, and says how that is called. */
  async adopt(hash, attributes = null) {
    const state = { headBlockHash: hash, safeBlockHash: hash, finalizedBlockHash: hash };
    const { payloadStatus, payloadId } = await this.engine("engine_forkchoiceUpdatedV2", state, attributes);
    if (payloadStatus.status !== "VALID") throw new Error(`${this.name} does not take ${hash}: ${payloadStatus.status}`);
    return payloadId;
  }

  /** The transactions that wait for a block. */
  async waiting() {
    const { pending } = await this.rpc("txpool_content");
    return Object.values(pending).flatMap((byNonce) => Object.values(byNonce));
  }
}

/** A network on this machine. All of it is in `folder`, which exists. */
export class Network {
  /** All blocks behind the genesis. */
  blocks = [];
  turn = 0;

  constructor({ nodes, client, funded, folder, log = console.error }) {
    Object.assign(this, { client: realpathSync(client), funded, folder, log, secret: randomBytes(32) });
    this.names = Array.from({ length: nodes }, (_, index) => `domain-${index + 1}`);
    const library = createRequire(this.client);
    const { createCustomCommon, Mainnet } = library("@ethereumjs/common");
    const common = createCustomCommon({ chainId: CHAIN }, Mainnet, { hardfork: "shanghai" });
    const { createTxFromRPC } = library("@ethereumjs/tx");
    /** A transaction that a node shows, as it was signed. */
    this.signed = async (shown) => {
      const transaction = await createTxFromRPC(shown, { common });
      return `0x${Buffer.from(transaction.serialize()).toString("hex")}`;
    };
  }

  get height() {
    return this.blocks.length;
  }

  get urls() {
    return this.nodes.map((node) => node.url);
  }

  /** Starts all nodes, and waits until they answer. */
  async start() {
    writeFileSync(join(this.folder, "genesis.json"), JSON.stringify(genesis(this.funded)));
    writeFileSync(join(this.folder, "jwt"), this.secret.toString("hex"));
    const first = await freePorts(PORTS_EACH * this.names.length);
    const ports = (index) => Array.from({ length: PORTS_EACH }, (_, which) => first + PORTS_EACH * index + which);
    this.nodes = this.names.map((name, index) => new Node(this, name, ports(index)));
    this.nodes.forEach((node) => node.start());
    const answers = await Promise.all(this.nodes.map((node) => this.#genesisOf(node)));
    this.genesis = { blockHash: answers[0].hash, timestamp: answers[0].timestamp };
    if (answers.some(({ hash }) => hash !== this.genesis.blockHash)) throw new Error("the nodes are of different chains");
  }

  async #genesisOf(node) {
    while (node.child) {
      try {
        const block = await node.rpc("eth_getBlockByNumber", "0x0", false);
        node.height = 0;
        return block;
      } catch {
        await sleep(RETRY_MS);
      }
    }
    throw new Error(`${node.name} ended`);
  }

  /** Ends all nodes. */
  async stop() {
    this.log = () => {};
    await Promise.all((this.nodes ?? []).map((node) => node.kill()));
  }

  /** Has the node whose turn it is make a block and all that are there execute it. Returns whether there is one more. */
  async makeBlock() {
    if (this.nodes.every((node) => !node.child)) throw new Error("all nodes ended");
    this.#followAll();
    const present = this.nodes.filter((node) => node.height === this.height);
    if (present.length === 0) {
      await sleep(RETRY_MS);
      return false;
    }
    const maker = present[this.turn++ % present.length];
    const block = await this.#build(maker, present).catch((error) => this.#isAway(maker, error));
    if (!block) return false;
    const execute = (node) => node.execute(block).catch((error) => this.#isAway(node, error));
    const verdicts = await Promise.all(present.map(execute));
    const against = present.filter((_, index) => verdicts[index]?.startsWith("INVALID"));
    if (against.length > 0 || verdicts[present.indexOf(maker)] !== "VALID") {
      const names = against.map((node) => node.name).join(", ");
      this.log(`a block of ${maker.name} is given up${names && `: invalid, by ${names}`}`);
      return false;
    }
    this.blocks.push(block);
    this.#followAll();
    // Those that were away catch up by themselves.
    await Promise.all(present.map((node) => node.following));
    return true;
  }

  async #build(maker, present) {
    await this.#passOn(maker, present);
    const { blockHash, timestamp } = this.blocks.at(-1) ?? this.genesis;
    const time = Math.max(Number(timestamp) + 1, Math.floor(Date.now() / 1000));
    const attributes = { timestamp: hex(time), prevRandao: blockHash, suggestedFeeRecipient: ZERO.slice(0, 42), withdrawals: [] };
    const id = await maker.adopt(blockHash, attributes);
    const { executionPayload } = await maker.engine("engine_getPayloadV2", id);
    return executionPayload;
  }

  /** Nodes without peers keep the transactions of their users to themselves: whose turn it is gets those of all. */
  async #passOn(maker, present) {
    const pools = await Promise.all(present.map((node) => node.waiting().catch(() => [])));
    const known = new Set(pools[present.indexOf(maker)].map(({ hash }) => hash));
    const missing = new Map(pools.flat().filter(({ hash }) => !known.has(hash)).map((shown) => [shown.hash, shown]));
    const send = async (shown) => {
      try {
        await maker.rpc("eth_sendRawTransaction", await this.signed(shown));
      } catch (error) {
        // Such as one that is in a block already, or in whose place it has another.
        if (!(error instanceof Refused)) throw error;
      }
    };
    await Promise.all([...missing.values()].map(send));
  }

  #followAll() {
    for (const node of this.nodes) {
      if (node.child && !node.following && node.height !== this.height) {
        node.following = this.#follow(node).finally(() => (node.following = undefined));
      }
    }
  }

  /** Leads a node from where it is to the last block. */
  async #follow(node) {
    try {
      if (node.height === undefined) {
        const latest = await node.rpc("eth_getBlockByNumber", "latest", false);
        node.height = Number(latest.number);
      }
      while (node.height < this.height) {
        const block = this.blocks[node.height];
        const status = await node.execute(block);
        if (status !== "VALID") throw new Error(`${node.name} does not execute block ${node.height + 1}: ${status}`);
        await node.adopt(block.blockHash);
        node.height += 1;
      }
      node.isAway = false;
    } catch (error) {
      this.#isAway(node, error);
      await sleep(RETRY_MS);
    }
  }

  #isAway(node, error) {
    if (!node.isAway) this.log(`the others go on without ${node.name}: ${error.message}`);
    node.isAway = true;
    node.height = undefined;
  }
}

const hex = (number) => `0x${number.toString(16)}`;

/** A JSON web token (RFC 7519, HS256), as the Engine API asks for. */
function token(secret) {
  const part = (value) => Buffer.from(JSON.stringify(value)).toString("base64url");
  const signed = `${part({ alg: "HS256", typ: "JWT" })}.${part({ iat: Math.floor(Date.now() / 1000) })}`;
  return `${signed}.${createHmac("sha256", secret).update(signed).digest("base64url")}`;
}

/** A chain of the Shanghai fork from the beginning. */
function genesis(funded) {
  const forks = ["homestead", "eip150", "eip155", "eip158", "byzantium", "constantinople"];
  forks.push("petersburg", "istanbul", "berlin", "london");
  return {
    config: {
      ...{ chainId: CHAIN, mergeForkBlock: 0, terminalTotalDifficulty: 0, terminalTotalDifficultyPassed: true },
      ...Object.fromEntries(forks.map((fork) => [`${fork}Block`, 0])),
      shanghaiTime: 0,
    },
    alloc: Object.fromEntries(funded.map((account) => [account, { balance: "0xffffffffffffffffffffffff" }])),
    ...{ nonce: "0x0", timestamp: "0x5f5e1000", extraData: "0x", gasLimit: "0x1c9c380", difficulty: "0x0", mixHash: ZERO },
    ...{ coinbase: ZERO.slice(0, 42), baseFeePerGas: "0x7", number: "0x0", gasUsed: "0x0", parentHash: ZERO },
  };
}

/** So many ports in a row that nobody has; other processes look elsewhere first. */
async function freePorts(count) {
  const isFree = (port) =>
    new Promise((resolve) => {
      const server = net.createServer().once("error", () => resolve(false));
      server.listen(port, "127.0.0.1", () => server.close(() => resolve(true)));
    });
  const choices = Math.floor((PORTS[1] - PORTS[0]) / count);
  for (let choice = 0; choice < choices; choice++) {
    const first = PORTS[0] + ((choice + process.pid) % choices) * count;
    const free = await Promise.all(Array.from({ length: count }, (_, index) => isFree(first + index)));
    if (free.every(Boolean)) return first;
  }
  throw new Error(`there are no free ports between ${PORTS[0]} and ${PORTS[1]}`);
}

