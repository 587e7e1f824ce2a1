// A headless Chromium without a GPU for the benchmarks of the page, driven by chromedriver. Whatever a benchmark starts ends
// with it, by Ctrl-C, too.

import { spawn } from "node:child_process";
import { mkdtemp, rm } from "node:fs/promises";
import { setPriority, tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";

const ARGUMENTS = [
    "--headless=new", "--disable-gpu", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1440,900",
    // Windows below others count as visible, and draw as if they were in front.
    "--disable-backgrounding-occluded-windows", "--disable-renderer-backgrounding",
];

/** @type {(() => unknown)[]} */
const endings = [];
let interrupted = false;

/**
 * Calls a function when the benchmark ends, for whatever reason. The last one is called first.
 * @param {() => unknown} ending
 */
export function atEnd(ending) {
    endings.push(ending);
}

async function end() {
    for (let ending = endings.pop(); ending; ending = endings.pop()) {
        try {
            await ending();
        } catch (error) {
            console.error(`cannot clean up: ${error instanceof Error ? error.message : error}`);
        }
    }
}

/**
 * Runs a benchmark, and cleans up after it. An error is printed, and is the exit status.
 * @param {() => Promise<void>} measure
 */
export async function benchmark(measure) {
    const interrupt = async () => {
        if (interrupted) return;
        interrupted = true;
        await end();
        process.exit(130);
    };
    for (const signal of ["SIGINT", "SIGTERM", "SIGHUP"]) process.on(signal, interrupt);
    try {
        await measure();
    } catch (error) {
        // A browser that Ctrl-C cuts off fails, too.
        if (interrupted) return;
        console.error(error instanceof Error ? error.message : error);
        process.exitCode = 1;
    }
    if (!interrupted) await end();
    for (const signal of ["SIGINT", "SIGTERM", "SIGHUP"]) process.off(signal, interrupt);
}

/** Makes a temporary folder, which is removed at the end. */
export async function temporaryFolder() {
    const folder = await mkdtemp(join(tmpdir(), "cotorra-page-"));
    atEnd(() => rm(folder, { recursive: true, force: true, maxRetries: 5 }));
    return folder;
}

/** @param {number} ms */
export function sleep(ms) {
    return new Promise((resolve) => setTimeout(resolve, ms));
}

/**
 * Returns a quantile of some numbers; NaN if there are none.
 * @param {number[]} of
 * @param {number} share
 */
export function quantile(of, share) {
    const sorted = of.slice().sort((one, other) => one - other);
    return sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * share))] ?? NaN;
}

/** A browser with its windows, of which one gets the calls. */
export class Browser {
    #session;

    /** @param {string} session Address of a session of chromedriver. */
    constructor(session) {
        this.#session = session;
    }

    /**
     * Starts a browser with one empty window.
     * @param {number} [nice] Of all its processes: 19 leaves the CPUs to others.
     */
    static async start(nice = 0) {
        const folder = await temporaryFolder();
        // In a group of its own, so that Ctrl-C leaves the order of ending to us, and nothing of it stays.
        const driver = spawn("chromedriver", ["--port=0"], { stdio: ["ignore", "pipe", "ignore"], detached: true, env: { ...process.env, TMPDIR: folder } });
        await new Promise((resolve, reject) => {
            driver.once("spawn", resolve);
            driver.once("error", () => reject(new Error("cannot start chromedriver: install chromium and chromedriver")));
        });
        if (driver.pid !== undefined) setPriority(driver.pid, nice);
        const ended = new Promise((resolve) => driver.once("exit", resolve));
        atEnd(async () => {
            if (driver.pid !== undefined && driver.exitCode === null) process.kill(-driver.pid, "SIGKILL");
            await ended;
        });
        let port;
        for await (const line of createInterface({ input: driver.stdout })) {
            port = /successfully on port (\d+)/.exec(line)?.[1];
            if (port) break;
        }
        const sessions = `http://127.0.0.1:${port}/session`;
        const options = { args: [...ARGUMENTS, `--user-data-dir=${join(folder, "profile")}`] };
        const { sessionId } = await call("POST", sessions, { capabilities: { alwaysMatch: { "goog:chromeOptions": options } } });
        const browser = new Browser(`${sessions}/${sessionId}`);
        atEnd(() => call("DELETE", `${sessions}/${sessionId}`));
        return browser;
    }

    /**
     * Opens an address, and waits until the page is loaded.
     * @param {string} url
     */
    open(url) {
        return call("POST", `${this.#session}/url`, { url });
    }

    /** Opens another window, which can be selected. Unlike a tab, it stays visible. */
    openWindow() {
        return call("POST", `${this.#session}/window/new`, { type: "window" });
    }

    /**
     * Returns the names of all windows.
     * @returns {Promise<string[]>}
     */
    windows() {
        return call("GET", `${this.#session}/window/handles`);
    }

    /**
     * Directs calls to a window.
     * @param {string} handle
     */
    select(handle) {
        return call("POST", `${this.#session}/window`, { handle });
    }

    /**
     * Runs statements in the page, and returns what they return. If that is a promise, waits for it.
     * @param {string} script
     * @returns {Promise<any>}
     */
    evaluate(script) {
        return call("POST", `${this.#session}/execute/sync`, { script, args: [] });
    }

    /**
     * Calls the DevTools protocol.
     * @param {string} cmd
     * @param {object} [params]
     * @returns {Promise<any>}
     */
    command(cmd, params = {}) {
        return call("POST", `${this.#session}/goog/cdp/execute`, { cmd, params });
    }

    /**
     * Runs statements in each page that is opened from now on, before its own.
     * @param {string} source
     */
    inject(source) {
        return this.command("Page.addScriptToEvaluateOnNewDocument", { source });
    }

    /**
     * Waits until an expression is true in the page.
     * @param {string} expression
     * @param {number} [seconds]
     */
    async wait(expression, seconds = 60) {
        for (const last = Date.now() + seconds * 1000; Date.now() < last; await sleep(100)) {
            if (await this.evaluate(`return Boolean(${expression})`)) return;
        }
        throw new Error(`after ${seconds} s, the page still lacks: ${expression}`);
    }

    /**
     * Returns figures of the page, as the DevTools protocol names them.
     * @returns {Promise<Record<string, number>>}
     */
    async metrics() {
        await this.command("Performance.enable");
        const { metrics } = await this.command("Performance.getMetrics");
        return Object.fromEntries(metrics.map((/** @type {{ name: string, value: number }} */ { name, value }) => [name, value]));
    }
}

/**
 * Makes a call of WebDriver.
 * @param {string} method
 * @param {string} url
 * @param {object} [body]
 * @returns {Promise<any>}
 */
async function call(method, url, body) {
    const { value } = await (await fetch(url, { method, body: body && JSON.stringify(body) })).json();
    if (value?.error) throw new Error(value.message);
    return value;
}
