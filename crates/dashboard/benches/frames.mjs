// How long a frame of the charts takes on the page's main thread: 10 robots that send 20 service times a second each, in a
// headless browser without a GPU.
//
//   node crates/dashboard/benches/frames.mjs [--seconds 20] [--robots 10] [--plotly plotly.min.js] [--profile FILE]
//
// With --plotly, the same lines are drawn by Plotly.js instead of by the dashboard. `cargo add plotly` brings its file, in
// resource/ of the crate. --profile writes what the main thread did, as FILE.cpuprofile for the browser's developer tools.
// Needs chromedriver and chromium.

import { readFile, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { parseArgs } from "node:util";

import { atEnd, benchmark, Browser, sleep } from "./browser.mjs";

const { values: options } = parseArgs({
    options: {
        seconds: { type: "string", default: "20" }, robots: { type: "string", default: "10" }, plotly: { type: "string" },
        profile: { type: "string" },
    },
});
const seconds = Number(options.seconds);
const robots = Array.from({ length: Number(options.robots) }, (_, i) => `robot-${i}`);
const units = ["R1", "R2", "R3", "R4", "R5", "R6"];
const page = new URL("../page/", import.meta.url);

const testbed = {
    name: "benchmark", description: "", version: "", plugins: [],
    graph: {
        domains: [], links: [], wireless: {},
        nodes: [
            ...robots.map((id, i) => ({ id, kind: "robot", position: { x: i, y: 0 } })),
            ...units.map((id, i) => ({ id, kind: "radio_unit", position: { x: 3 * i, y: 3 } })),
        ],
    },
    services: robots.map((robot) => ({
        id: `walk-${robot}`, robot, vnfs: [], virtual_links: [], kpis: { service_time_target_ms: 15 },
    })),
    walks: [],
};

/** What happens at a time, in steps of 50 ms. */
function events(step) {
    const at_ns = step * 50e6;
    const all = robots.map((robot, i) => ({
        at_ns, event: "service_time", service: `walk-${robot}`, robot, sequence: step, emitted_ns: at_ns, server: "edge",
        service_time_ms: 11 + i + 3 * Math.sin(step / 30 + i) + (step % 97 === i ? 80 : 0),
    }));
    if (step % 2 === 0) {
        for (const [i, robot] of robots.entries()) {
            const attachments = units.map((radio_unit, j) => ({
                radio_unit, attached: j === Math.floor(step / 200 + i) % units.length, signal_dbm: -50 - j - 5 * Math.sin(step / 50 + j),
            }));
            const pose = { x: i + step / 100, y: Math.sin(step / 40 + i), heading: 0, covariance: [0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01] };
            all.push({ at_ns, event: "robot", robot, waypoint: 0, attachments, sensors: { pose, velocity: { linear: 0.3, angular: 0 } } });
        }
    }
    if (step % 200 === 0 && step > 0) {
        for (const [i, robot] of robots.entries()) {
            const at = (n) => units[(Math.floor(step / 200 + i) + n) % units.length];
            all.push({ at_ns, event: "handover", robot, from: at(-1 + units.length), to: at(0), fast: true, gap_ms: 30 });
        }
    }
    return all;
}

const empty = { items: [], next: null };
const answers = {
    "/api/v1/testbed": testbed,
    "/api/v1/measurements/verdict": null,
    "/api/v1/measurements/kpis": [],
    "/api/v1/clock": { at_ns: 0, controllable: false, paused: false, speed: 1 },
    "/api/v1/measurements/events": empty,
    "/api/v1/measurements/state": { at_ns: 0, robots: [], radio_units: [], links: [], placements: [], virtual_links: [] },
};
const plotly = `<!doctype html><body><div id="chart" style="width:800px;height:400px"></div>
<script src="/plotly.js"></script><script src="/plotly-page.js"></script>`;
const plotlyPage = `
const robots = ${JSON.stringify(robots)};
const waiting = robots.map(() => [[], []]);
const frames = { times: [], quantile(share) { return this.times.slice().sort((a, b) => a - b)[Math.floor(this.times.length * share)]; } };
globalThis.cotorraFrames = frames;
const style = robots.map((name) => ({ x: [], y: [], name, mode: "lines" }));
Plotly.newPlot("chart", style, { xaxis: { range: [0, 60] } }, { staticPlot: true }).then(() => {
    let last = 0;
    const source = new EventSource("/api/v1/events");
    source.onmessage = ({ data }) => {
        const event = JSON.parse(data);
        if (event.event !== "service_time") return;
        const line = waiting[robots.indexOf(event.robot)];
        last = event.at_ns / 1e9;
        line[0].push(last);
        line[1].push(event.service_time_ms);
    };
    const frame = () => {
        if (waiting[0][0].length > 0) {
            const began = performance.now();
            Plotly.extendTraces("chart", { x: waiting.map(([x]) => x), y: waiting.map(([, y]) => y) }, robots.map((_, i) => i), 1200);
            Plotly.relayout("chart", { "xaxis.range": [last - 60, last] });
            frames.times.push(performance.now() - began);
            for (const line of waiting) line[0] = [], line[1] = [];
        }
        requestAnimationFrame(frame);
    };
    frame();
});`;

const server = createServer(async (request, response) => {
    const path = request.url.split("?")[0];
    const send = (type, body) => response.writeHead(200, { "Content-Type": type }).end(body);
    if (path === "/api/v1/events") {
        response.writeHead(200, { "Content-Type": "text/event-stream" });
        // A minute at once, so that the window is full, and then as it comes.
        let step = 0;
        const next = () => response.write(events(step++).map((event) => `data: ${JSON.stringify(event)}\n\n`).join(""));
        while (step < 1200) next();
        const timer = setInterval(next, 50);
        response.on("close", () => clearInterval(timer));
    } else if (path in answers) send("application/json", JSON.stringify(answers[path]));
    else if (path === "/" && options.plotly) send("text/html", plotly);
    else if (path === "/plotly.js") send("text/javascript", await readFile(options.plotly));
    else if (path === "/plotly-page.js") send("text/javascript", plotlyPage);
    else {
        const name = path === "/" ? "index.html" : path.replace("/dashboard/", "");
        const type = name.endsWith("js") ? "text/javascript" : name.endsWith("css") ? "text/css" : name.endsWith("svg") ? "image/svg+xml" : "text/html";
        const body = await readFile(new URL(name, page)).catch(() => null);
        if (body) send(type, body);
        else response.writeHead(404, { "Content-Type": "application/json" }).end("{}");
    }
});

async function measure() {
    await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
    atEnd(() => {
        server.close();
        server.closeAllConnections();
    });
    const browser = await Browser.start();
    await browser.open(`http://127.0.0.1:${server.address().port}/`);
    const frames = () => browser.evaluate("return cotorraFrames.count ?? cotorraFrames.times.length");
    await sleep(5000);
    if (options.profile) {
        await browser.command("Profiler.enable");
        await browser.command("Profiler.start");
    }
    const [before, first] = [await browser.metrics(), await frames()];
    await sleep(seconds * 1000);
    const [after, last] = [await browser.metrics(), await frames()];
    if (options.profile) await writeFile(`${options.profile}.cpuprofile`, JSON.stringify((await browser.command("Profiler.stop")).profile));
    const [median, p95, p99] = await browser.evaluate("return [0.5, 0.95, 0.99].map((share) => cotorraFrames.quantile(share))");
    const busy = after.TaskDuration - before.TaskDuration;
    console.log(`${options.plotly ? "Plotly.js" : "the dashboard"}: ${((last - first) / seconds).toFixed(1)} frames a second, ` +
        `${median.toFixed(1)} ms median, ${p95.toFixed(1)} ms p95, ${p99.toFixed(1)} ms p99; main thread busy ` +
        `${(100 * busy / (after.Timestamp - before.Timestamp)).toFixed(0)} % of the time, ` +
        `${(1e3 * busy / (last - first)).toFixed(1)} ms a frame in all, ` +
        `${(1e3 * (after.ThreadTime - before.ThreadTime) / (last - first)).toFixed(1)} ms of CPU; ${(after.JSHeapUsedSize / 1e6).toFixed(1)} MB of heap`);
}

await benchmark(measure);
