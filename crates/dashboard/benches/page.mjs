// The promises of the dashboard beside a run, measured with the real program and a headless browser without a GPU. Prints a line
// for each figure: median, tail and goal.

import { spawn } from "node:child_process";
import { readdir, readFile } from "node:fs/promises";
import { cpus, loadavg } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import { EventParser } from "../page/api.js";
import { atEnd, benchmark, Browser, quantile, sleep, temporaryFolder } from "./browser.mjs";

const HELP = `node crates/dashboard/benches/page.mjs [PART…] [OPTION…]

Parts; without any, all of them:
  handover   time from a handover until map, charts and timeline show it. Needs root
  open       time from an address until an hour of history is drawn
  memory     the page's memory while an hour is replayed 10 times as fast. Takes 6 minutes
  pages      how much ten open pages change the emulator's lateness. Needs root, takes 11 minutes

Options:
  --cotorra FILE   the program; default: target/release/cotorra
  --run DIR        open, memory: a recorded run, instead of an hour that is simulated first
  --times N        handover: handovers, 40; open: openings, 10; pages: pairs of runs, 5
  --seconds N      memory: length of the replay, 350; pages: length of a run, 60
  --nice N         pages: niceness of the browser, 0. With 19 it takes the CPUs that nobody else wants, so that what is left
                   is what the run does for the pages: as if they were open on another machine
  --help

Needs chromium and chromedriver.`;

const root = new URL("../../../", import.meta.url);
const testbed = fileURLToPath(new URL("testbeds/corridor.yaml", root));
const HOUR_S = 3600;

const { values: options, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        cotorra: { type: "string", default: fileURLToPath(new URL("target/release/cotorra", root)) },
        run: { type: "string" }, times: { type: "string" }, seconds: { type: "string" }, nice: { type: "string", default: "0" },
        help: { type: "boolean" },
    },
});
const times = (/** @type {number} */ usual) => Number(options.times ?? usual);
const seconds = (/** @type {number} */ usual) => Number(options.seconds ?? usual);

/** A `cotorra` that serves a page, until it is stopped or ends by itself. */
class Server {
    #said = "";
    #process;

    /** @param {string[]} args */
    constructor(args) {
        const { COTORRA_TOKEN: _, ...env } = process.env;
        // In a group of its own: Ctrl-C reaches it once, by us, so that it ends in order.
        this.#process = spawn(options.cotorra, args, { stdio: ["ignore", "ignore", "pipe"], detached: true, env });
        this.#process.stderr.setEncoding("utf8").on("data", (text) => (this.#said += text));
        this.ended = new Promise((resolve, reject) => {
            this.#process.once("close", resolve);
            this.#process.once("error", reject);
        });
        this.ended.catch(() => {});
        atEnd(() => this.stop());
    }

    /** Returns the address of the page, once it is served. */
    async address() {
        const ended = this.ended.then((status) => {
            throw new Error(`cotorra ended with status ${status}:\n${this.#said}`);
        });
        ended.catch(() => {});
        for (;;) {
            const found = /Dashboard on (http:[^\s,]+)/.exec(this.#said);
            if (found) return found[1];
            await Promise.race([ended, sleep(50)]);
        }
    }

    /** Returns when it has ended with figures, valid or not. */
    async finish() {
        const status = await this.ended;
        if (status !== 0 && status !== 3) throw new Error(`cotorra ended with status ${status}:\n${this.#said}`);
    }

    async stop() {
        const { pid } = this.#process;
        if (pid === undefined || this.#process.exitCode !== null || this.#process.signalCode !== null) return;
        this.#process.kill("SIGINT");
        const late = setTimeout(() => process.kill(-pid, "SIGKILL"), 20_000);
        await this.ended;
        clearTimeout(late);
    }
}

/**
 * @param {string} name
 * @param {number[]} samples
 * @param {string} unit
 * @param {string} goal
 */
function report(name, samples, unit, goal) {
    const [median, p95, most] = [quantile(samples, 0.5), quantile(samples, 0.95), Math.max(...samples)];
    const words = [`${median.toFixed(0)} ${unit} median`, `${p95.toFixed(0)} ${unit} p95`, `${most.toFixed(0)} ${unit} at most`];
    console.log(`${name}: ${words.join(", ")}; ${samples.length} times${goal && `; goal: ${goal}`}`);
}

/**
 * Follows the events of a run, and notes when they come.
 * @param {string} address
 * @param {string[]} kinds
 */
async function follow(address, kinds) {
    const controller = new AbortController();
    const answer = await fetch(`${address}api/v1/events?kinds=${kinds.join(",")}`, { signal: controller.signal });
    /** @type {{ came: number, event: any }[]} */
    const events = [];
    const parser = new EventParser();
    const read = async () => {
        for await (const text of answer.body.pipeThrough(new TextDecoderStream())) {
            const came = Date.now();
            for (const { name, data } of parser.push(text)) if (name === "message") events.push({ came, event: JSON.parse(data) });
        }
    };
    const ended = read().catch(() => {});
    return { events, stop: () => (controller.abort(), ended) };
}

/** Runs in the page: notes in `cotorraShown` when a view shows another radio unit, after the frame is painted. */
const WATCH = `{
    const shown = globalThis.cotorraShown = [];
    const last = new Map();
    const note = (view, what) => {
        if (!what || last.get(view) === what) return;
        last.set(view, what);
        setTimeout(() => shown.push({ view, what, at: Date.now() }));
    };
    const views = new Map();
    const viewOf = (canvas) => {
        if (!views.has(canvas)) views.set(canvas, canvas.closest("#map") ? "map" : canvas.closest(".chart") ? "chart " + views.size : "");
        return views.get(canvas);
    };
    const { prototype } = CanvasRenderingContext2D;
    const { clearRect, fillRect, fillText } = prototype;
    const units = new Map();
    // A drawing begins with an empty canvas. It is complete when its frame's function returns.
    prototype.clearRect = function (...all) {
        const { canvas } = this;
        if (viewOf(canvas) && canvas.role === "img") queueMicrotask(() => note(viewOf(canvas), units.get(canvas)));
        clearRect.apply(this, all);
    };
    // The last region of a chart has the colour of the present radio unit. On the map, its name is bold.
    prototype.fillRect = function (...all) {
        if (viewOf(this.canvas).startsWith("chart")) units.set(this.canvas, this.fillStyle);
        fillRect.apply(this, all);
    };
    prototype.fillText = function (...all) {
        if (viewOf(this.canvas) === "map" && this.font.startsWith("bold")) units.set(this.canvas, all[0]);
        fillText.apply(this, all);
    };
    const look = () => note("timeline", document.querySelector("#timeline [data-group=handover] .what")?.textContent);
    new MutationObserver(look).observe(document, { childList: true, subtree: true });
}`;

/** Measures how long it takes until a handover is seen. */
async function handover() {
    const count = times(40);
    const folder = await temporaryFolder();
    const server = new Server(["run", testbed, "--headless", "--api", "127.0.0.1:0", "--until", `${3 * count + 60}s`, "--out", folder]);
    const address = await server.address();
    const browser = await Browser.start();
    await browser.inject(WATCH);
    await browser.open(address);
    await browser.wait("document.body.dataset.ready !== undefined && document.querySelector('#robots td').textContent !== '–'");
    const { events, stop } = await follow(address, ["handover", "robot", "service_time"]);
    for (let i = 0; i < count; i++) {
        const instruction = { instruction: "attach", robot: "robot", radio_unit: i % 2 === 0 ? "R3" : "R1" };
        const headers = { "Content-Type": "application/json" };
        await fetch(`${address}api/v1/instructions`, { method: "POST", headers, body: JSON.stringify({ instruction, reason: "benchmark" }) });
        // At all phases of the reports' periods.
        await sleep(1500 + 37 * (i % 20));
    }
    const shown = /** @type {{ view: string, what: string, at: number }[]} */ (await browser.evaluate("return cotorraShown"));
    await stop();
    await server.stop();
    // The event that came fastest gives the beginning of the run's time.
    const began = Math.min(...events.map(({ came, event }) => came - event.at_ns / 1e6));
    const handovers = events.filter(({ event }) => event.event === "handover");
    if (handovers.length === 0) throw new Error("the run had no handover");
    const charts = [...new Set(shown.map(({ view }) => view).filter((view) => view.startsWith("chart")))];
    const [arrivals, maps, inCharts, timelines] = [[], [], [], []].map((all) => /** @type {number[]} */ (all));
    for (const { came, event: { at_ns, from, to } } of handovers) {
        const at = began + at_ns / 1e6;
        const after = (/** @type {string} */ view, /** @type {(what: string) => boolean} */ is) =>
            (shown.find((one) => one.view === view && one.at >= at && is(one.what))?.at ?? Infinity) - at;
        arrivals.push(came - at);
        maps.push(after("map", (unit) => unit === to));
        inCharts.push(Math.max(...charts.map((chart) => after(chart, () => true))));
        timelines.push(after("timeline", (title) => title.endsWith(`${from} → ${to}`)));
    }
    report("handover until its event is at another client", arrivals, "ms", "");
    report("handover until the map shows it", maps, "ms", "200 ms");
    report(`handover until all ${charts.length} charts show it`, inCharts, "ms", "200 ms");
    report("handover until the timeline shows it", timelines, "ms", "200 ms");
}

/** The run of an hour, once it is there. @type {string | undefined} */
let recorded = options.run;

/** Returns a run of an hour: the corridor up and down, with OKpi. */
async function hour() {
    if (recorded !== undefined) return recorded;
    const folder = await temporaryFolder();
    const there = [...(await readFile(testbed, "utf8")).matchAll(/^ +- (\[-?[\d.]+, -?[\d.]+\])$/gm)].map(([, point]) => point);
    const walk = Array.from({ length: 10 }, () => [...there, ...there.slice(1, -1).reverse()]).flat();
    const settings = ["plugin=okpi", `walks.robot.waypoints=[${walk.join(", ")}]`].flatMap((setting) => ["--set", setting]);
    await new Server(["run", testbed, "--simulate", "--headless", "--until", `${HOUR_S}s`, ...settings, "--out", folder]).finish();
    const [run] = await readdir(folder);
    const summary = JSON.parse(await readFile(join(folder, run, "summary.json"), "utf8"));
    if (summary.duration_ms < HOUR_S * 1000) throw new Error(`the robot's walk ended after ${summary.duration_ms / 1000} s`);
    return (recorded = join(folder, run));
}

/** Runs in the page: notes in `cotorraOpened` when the first drawing is painted, ms since the address was opened. */
const OPENED = `new MutationObserver((_, observer) => {
    if (document.body?.dataset.ready === undefined) return;
    observer.disconnect();
    requestAnimationFrame(() => setTimeout(() => globalThis.cotorraOpened = performance.now()));
}).observe(document, { subtree: true, childList: true, attributes: true, attributeFilter: ["data-ready"] });`;

/** Measures how long it takes until an hour of history is drawn. */
async function open() {
    const server = new Server(["view", await hour(), "--api", "127.0.0.1:0"]);
    const address = await server.address();
    const browser = await Browser.start();
    await browser.inject(OPENED);
    await browser.command("Network.enable");
    await browser.command("Network.setCacheDisabled", { cacheDisabled: true });
    /** @type {number[]} */
    const took = [];
    /** Time of each request. @type {Map<string, number[]>} */
    const requests = new Map();
    for (let i = 0; i < times(10); i++) {
        await browser.open("about:blank");
        await browser.open(address);
        await browser.wait("globalThis.cotorraOpened");
        took.push(await browser.evaluate("return cotorraOpened"));
        const all = await browser.evaluate("return performance.getEntriesByType('resource').map(({ name, duration }) => [name, duration])");
        for (const [name, duration] of all) {
            const path = name.replace(address, "/");
            requests.set(path, [...(requests.get(path) ?? []), duration]);
        }
    }
    await server.stop();
    report("an hour of history until it is drawn", took, "ms", "1000 ms");
    const slowest = [...requests].filter(([path]) => !path.startsWith("/api/v1/events?")).map(([path, all]) => ({ path, ms: quantile(all, 0.5) }));
    slowest.sort((one, other) => other.ms - one.ms);
    console.log(`  ${requests.size} requests; slowest: ${slowest.slice(0, 3).map(({ path, ms }) => `${path} ${ms.toFixed(0)} ms`).join(", ")}`);
}

/** Seconds between two samples of the memory, and before the first that counts. */
const EVERY_S = 20;
const SETTLED_S = 60;

/** Measures the page's memory while an hour is replayed. */
async function memory() {
    const server = new Server(["replay", await hour(), "--speed", "10x", "--api", "127.0.0.1:0"]);
    const address = await server.address();
    const browser = await Browser.start();
    await browser.open(address);
    await browser.wait("document.body.dataset.ready !== undefined");
    const began = Date.now();
    const samples = [];
    for (let at = EVERY_S; at <= seconds(350); at += EVERY_S) {
        await sleep(began + at * 1000 - Date.now());
        await browser.command("HeapProfiler.collectGarbage");
        const [{ usedSize, backingStorageSize }, { Nodes, JSEventListeners }] = [await browser.command("Runtime.getHeapUsage"), await browser.metrics()];
        const [heap, arrays] = [usedSize / 1e6, (backingStorageSize ?? 0) / 1e6];
        samples.push({ at, heap, arrays, megabytes: heap + arrays, nodes: Nodes, listeners: JSEventListeners });
    }
    const clock = await browser.evaluate("return document.getElementById('clock').textContent");
    await server.stop();
    const [first, last] = [samples[0], samples.at(-1)];
    if (!first || !last) throw new Error(`--seconds must be ${EVERY_S} or more`);
    const most = Math.max(...samples.map(({ megabytes }) => megabytes));
    const settled = samples.filter(({ at }) => at >= SETTLED_S).map(({ at, megabytes }) => [at, megabytes]);
    console.log(`memory in a replay at 10x, up to ${clock}: ${first.megabytes.toFixed(2)} MB after ${first.at} s, ` +
        `${last.megabytes.toFixed(2)} MB after ${last.at} s, ${most.toFixed(2)} MB at most; ` +
        `${(slope(settled) * 60_000).toFixed(0)} kB a minute after the first; goal: flat`);
    console.log(`  ${first.nodes} to ${last.nodes} nodes, ${first.listeners} to ${last.listeners} listeners; ` +
        `heap + arrays in MB: ${samples.map(({ heap, arrays }) => `${heap.toFixed(2)} + ${arrays.toFixed(2)}`).join(", ")}`);
}

/**
 * Returns the slope of the line that fits some points best.
 * @param {number[][]} points
 */
function slope(points) {
    const mean = (/** @type {number[]} */ of) => of.reduce((sum, one) => sum + one, 0) / of.length;
    const [x, y] = [0, 1].map((i) => mean(points.map((point) => point[i])));
    return mean(points.map(([at, value]) => (at - x) * (value - y))) / mean(points.map(([at]) => (at - x) ** 2));
}

const PAGES = 10;
/** Pages of one browser. It keeps six connections to a server, each page holds one, and the sixth is for what they ask. */
const MOST_PAGES = 5;

/** Measures how much open pages change the emulator's lateness. */
async function pages() {
    const browsers = await Promise.all(Array.from({ length: PAGES / MOST_PAGES }, () => Browser.start(Number(options.nice))));
    for (const browser of browsers) for (let i = 1; i < MOST_PAGES; i++) await browser.openWindow();
    /** @param {(browser: Browser) => Promise<unknown>} visit */
    const each = (visit) => Promise.all(browsers.map(async (browser) => {
        for (const window of await browser.windows()) {
            await browser.select(window);
            await visit(browser);
        }
    }));
    /** Frames a second of all pages. @type {number[]} */
    const frames = [];
    /** @param {boolean} isWatched */
    const p99 = async (isWatched) => {
        const folder = await temporaryFolder();
        const server = new Server(["run", testbed, "--headless", "--api", "127.0.0.1:0", "--until", `${seconds(60)}s`, "--out", folder]);
        const address = await server.address();
        if (isWatched) {
            const opened = each((browser) => browser.open(address)).then(() => each((browser) => browser.wait("document.body.dataset.ready !== undefined")));
            const inTime = await Promise.race([opened.then(() => true), server.ended.then(() => false)]);
            if (!inTime) throw new Error(`the run ended before ${PAGES} pages were open; give it more --seconds`);
        }
        await server.finish();
        if (isWatched) {
            await each(async (browser) => frames.push((await browser.evaluate("return cotorraFrames.count")) / seconds(60)));
            await each((browser) => browser.open("about:blank"));
        }
        const [run] = await readdir(folder);
        return JSON.parse(await readFile(join(folder, run, "summary.json"), "utf8")).fidelity.lateness_us.p99;
    };
    const ratios = [];
    for (let pair = 0; pair < times(5); pair++) {
        // Either is first as often as the other.
        const order = pair % 2 === 0 ? [false, true] : [true, false];
        const found = new Map();
        for (const isWatched of order) found.set(isWatched, await p99(isWatched));
        ratios.push(found.get(true) / found.get(false));
        console.log(`  lateness p99: ${found.get(false).toFixed(0)} µs without pages, ${found.get(true).toFixed(0)} µs with ${PAGES}`);
    }
    console.log(`lateness p99 with ${PAGES} pages over that without: ${quantile(ratios, 0.5).toFixed(2)} median, ${Math.max(...ratios).toFixed(2)} at most, ` +
        `${ratios.length} pairs; goal: 1.10. A page drew ${quantile(frames, 0.5).toFixed(1)} frames a second, ${Math.min(...frames).toFixed(1)} at least`);
}

const parts = new Map(Object.entries({ handover, open, memory, pages }));
const unknown = positionals.find((name) => !parts.has(name));
if (options.help) console.log(HELP);
else if (unknown !== undefined) {
    console.error(`there is no part ${unknown}; choose from ${[...parts.keys()].join(", ")}`);
    process.exitCode = 2;
} else {
    await benchmark(async () => {
        console.log(`${options.cotorra}; ${cpus().length} CPUs, load ${loadavg()[0].toFixed(1)}`);
        for (const name of positionals.length > 0 ? positionals : parts.keys()) await parts.get(name)?.();
        console.log(`load ${loadavg()[0].toFixed(1)} at the end`);
    });
}
