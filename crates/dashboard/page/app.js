// The page: connects to the API, keeps the model, and draws once a frame what has changed.

import { ActionPanel } from "./action_panel.js";
import { Api, Refused, Unauthorized } from "./api.js";
import { Charts } from "./charts.js";
import { CoverageButton } from "./coverage.js";
import { Details } from "./detail.js";
import { byId, element, rarely, setText } from "./dom.js";
import { clock, figure } from "./format.js";
import { judged } from "./kept.js";
import { MapView } from "./map.js";
import { Moment } from "./moment.js";
import { palette } from "./palette.js";
import { read } from "./pgm.js";
import { RobotsTable } from "./robots.js";
import { ScanButton } from "./scan.js";
import { HAPPENINGS, KINDS, Model } from "./state.js";
import { TimeAxis } from "./time_axis.js";
import { TimeControl } from "./time_control.js";
import { Timeline } from "./timeline.js";
import { Topology } from "./topology.js";
import { UNITS } from "./units.js";

/** @typedef {import("#api").components["schemas"]} Schemas */
/** @typedef {import("./state.js").Stamped} Stamped */

/** Pauses before the next attempt to connect, seconds. */
const PAUSES = [0.5, 1, 2, 5, 10];
/** Points of a figure of the history. */
const POINTS = 1000;
/** Figures of the history that are read at first. */
const MOST_FIGURES = 60;
/** Pages of the history's events that are read. */
const MOST_PAGES = 5;
/** Events that wait until the history is read. */
const MOST_WAITING = 50_000;

const api = new Api();
const axis = new TimeAxis();
const actions = new ActionPanel((call) => api.send(call), (goal, picked) => views?.map.aim(goal, picked));
const moment = new Moment((at_ns) => api.get("measurements/state", { at_ns }), (model, at) => {
    if (!views) return;
    for (const view of [views.map, views.topology, views.robots]) view.show(model);
    views.charts.pin(at);
    const { now } = views.model;
    const { from, until } = axis.window(now);
    if (at === null) axis.follow();
    else if (at < from || at > until) axis.centre(at, now);
    changed();
});
const time = new TimeControl(byId("time-control"), (change) => api.send({ method: "POST", path: "/api/v1/clock", body: change }), (error) => {
    connection("live", error instanceof Refused ? `Refused: ${error.message}` : String(error));
});
const dark = matchMedia("(prefers-color-scheme: dark)");

/** @type {{ model: Model, map: MapView, topology: Topology, robots: RobotsTable, charts: Charts, timeline: Timeline, details: Details } | null} */
let views = null;
/** @type {string | null} */
let focus = null;
let wanted = false;
/** Version of the time axis whose stretch was looked at closely. */
let looked = -1;

/** Draws in the next frame, once. */
function changed() {
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(() => {
        wanted = false;
        const began = performance.now();
        render();
        frames.add(performance.now() - began);
    });
}

/**
 * Durations of the last frames, in milliseconds, with the events before each. For the benchmark and for users:
 * `cotorraFrames` in the console.
 */
const frames = {
    times: new Float64Array(1024),
    count: 0,
    events: 0,
    /** @param {number} took */
    add(took) {
        this.times[this.count++ % this.times.length] = took + this.events;
        this.events = 0;
    },
    /** @param {number} share */
    quantile(share) {
        const sorted = this.times.slice(0, Math.min(this.count, this.times.length)).sort();
        // Type 7 of Hyndman and Fan, as all of cotorra's quantiles.
        const rank = share * (sorted.length - 1);
        const [low, high] = [sorted[Math.floor(rank)], sorted[Math.ceil(rank)]];
        return low === undefined || high === undefined ? NaN : low + (high - low) * (rank % 1);
    },
};
Object.assign(globalThis, { cotorraFrames: frames });

function isDark() {
    return document.documentElement.dataset.theme ? document.documentElement.dataset.theme === "dark" : dark.matches;
}

const tellSoon = rarely(() => {
    views?.robots.draw(focus);
    actions.draw(focus);
    moment.draw();
});

function render() {
    if (!views) return;
    const { model } = views;
    const colours = palette(isDark());
    setText(byId("clock"), clock(moment.at ?? (axis.isLive ? model.now : axis.window(model.now).until)));
    if (byId("topology").hidden) views.map.draw(colours, focus);
    else views.topology.draw(colours);
    tellSoon();
    if (looked !== axis.version) {
        looked = axis.version;
        views.details.want(views.charts.figures(focus), axis.window(model.now));
    }
    views.charts.draw(colours, focus);
    views.timeline.draw();
    const fidelity = byId("fidelity");
    if (model.lateness) {
        fidelity.hidden = false;
        setText(fidelity, `late by ${figure(model.lateness.p99_us, UNITS.lateness_p99)} (p99)`);
    }
    for (const button of byId("spans").querySelectorAll("button")) {
        const { span } = button.dataset;
        const is = span === undefined ? axis.isLive : axis.isLive && axis.span === (span === "all" ? null : Number(span));
        button.setAttribute("aria-pressed", String(is));
    }
}

/**
 * @param {"connecting" | "live" | "waiting"} state
 * @param {string} text
 */
function connection(state, text) {
    const place = byId("connection");
    place.dataset.state = state;
    setText(place, text);
}

/** @param {string} robot */
function setFocus(robot) {
    focus = robot;
    changed();
}

/**
 * Reads everything that is known.
 * @param {AbortSignal} signal
 */
async function load(signal) {
    const [testbed, grid, verdict, kpis, clock] = await Promise.all([
        /** @type {Promise<Schemas["TestbedBody"]>} */ (api.get("testbed", {}, signal)),
        readMap(signal),
        /** @type {Promise<Schemas["Fidelity"] | null>} */ (api.get("measurements/verdict", {}, signal)),
        /** @type {Promise<Schemas["ServiceKpis"][]>} */ (api.get("measurements/kpis", {}, signal)),
        /** @type {Promise<Schemas["ClockBody"]>} */ (api.get("clock", {}, signal)),
    ]);
    /** @type {Schemas["GraphState"]} */
    const state = await api.get("measurements/state", {}, signal);
    const model = new Model(testbed);
    if (!focus || !model.robots.has(focus)) focus = [...model.robots.keys()][0] ?? null;
    await recount(model, signal);
    const compared = Number(new URLSearchParams(location.search).get("compare"));
    if (state.at_ns > 0) await recall(model, state, signal);
    if (compared > 0) await recallOther(model, state, compared, signal);
    model.begin(state);
    showVerdict(verdict);
    showKpis(judged(testbed.services, kpis));
    time.show(clock);
    return { model, grid };
}

/** @param {Schemas["Fidelity"] | null} verdict */
function showVerdict(verdict) {
    const place = byId("verdict");
    place.hidden = !verdict;
    if (!verdict) return;
    place.dataset.valid = String(verdict.valid);
    const [heading, reason] = place.children;
    setText(heading, verdict.exact ? "Exact by construction" : verdict.valid ? "Valid" : "Not valid");
    setText(reason, `The emulation was ${verdict.valid ? "as" : "not as"} the testbed file demands: ${verdict.reason}.`);
}

/** @param {ReturnType<typeof judged>} kpis */
function showKpis({ verdict, sentences }) {
    const place = byId("kpis");
    place.hidden = sentences.length === 0;
    place.dataset.valid = verdict ? String(verdict === "PASS") : "";
    const [heading, list] = place.children;
    setText(heading, `KPIs: ${verdict ?? "not judged yet"}`);
    setText(list, sentences.join(" "));
}

/**
 * @param {Model} model
 * @param {import("./map.js").Grid | null} grid
 */
function show(model, grid) {
    const closely = (/** @type {string} */ figure, /** @type {import("./detail.js").Stretch} */ { from, until }) => {
        const [from_ns, until_ns] = [from, until].map((at) => Math.round(at * 1e9));
        return /** @type {Promise<Schemas["Curve"]>} */ (api.get("measurements/series", { figure, points: POINTS, from_ns, until_ns }));
    };
    looked = -1;
    views = {
        model,
        details: new Details(model, closely, changed),
        map: new MapView(byId("map"), byId("map-tools"), model, grid, changed, setFocus),
        topology: new Topology(byId("topology"), model, changed, (what) => actions.choose(what)),
        robots: new RobotsTable(byId("robots"), model, setFocus),
        charts: new Charts(byId("charts"), model, axis, changed),
        timeline: new Timeline(byId("timeline"), byId("timeline-tools"), model, changed, (entry) => {
            if (entry.robot) focus = entry.robot;
            axis.centre(entry.at, model.now);
            changed();
        }),
    };
    actions.show(model);
    moment.begin(model);
    const { map } = views;
    new CoverageButton(byId("map-tools"), model, () => api.get("network/coverage"), (coverage, legend) => map.showCoverage(coverage, legend));
    new ScanButton(byId("map-tools"), model, () => focus, (path) => api.bytes(path), (robot, points) => map.showScan(robot, points));
    document.title = `${model.testbed.name} · cotorra`;
    setText(byId("name"), model.testbed.name);
    byId("name").title = model.testbed.description;
    document.body.dataset.ready = "";
    changed();
}

/** @param {AbortSignal} signal */
async function readMap(signal) {
    try {
        const place = /** @type {Schemas["MapBody"]} */ (await api.get("map", {}, signal));
        return { place, ...read(await api.bytes("map/image", signal)) };
    } catch (error) {
        if (error instanceof Refused && error.status === 404) return null;
        throw error;
    }
}

/**
 * Reads what happened so far.
 * @param {Model} model
 * @param {AbortSignal} signal
 */
async function recount(model, signal) {
    /** @type {string | undefined} */
    let after;
    for (let page = 0; page < MOST_PAGES; page++) {
        const query = { kinds: HAPPENINGS.join(","), limit: 2000, after };
        const answer = /** @type {Schemas["Page_Stamped"]} */ (await api.get("measurements/events", query, signal));
        for (const event of answer.items) model.recount(event);
        if (!answer.next) return;
        after = answer.next;
    }
}

/**
 * Returns the figures that are read from the history.
 * @param {Model} model
 * @param {Schemas["GraphState"]} state
 */
function recalled(model, state) {
    const services = model.testbed.services.map(({ id }) => `service_time:${id}`);
    const signals = focus ? model.units.map((unit) => `signal:${focus}:${unit}`) : [];
    const links = state.virtual_links.flatMap(({ links }) => links);
    const delays = [...new Set(links)].flatMap((link) => [`delay:${link}:forward`, `delay:${link}:backward`]);
    const isLocated = state.robots.some(({ robot, localization_error_m }) => robot === focus && typeof localization_error_m === "number");
    return [...services, ...(isLocated ? [`localization_error:${focus}`] : []), ...delays, ...signals].slice(0, MOST_FIGURES);
}

/**
 * @param {string} figure
 * @param {number | undefined} run Another run of the same history.
 * @param {AbortSignal} signal
 * @returns {Promise<Schemas["Curve"]>}
 */
function readCurve(figure, run, signal) {
    return api.get("measurements/series", { figure, points: POINTS, run }, signal);
}

/**
 * Reads the figures of another run, to be drawn beside this one's.
 * @param {Model} model
 * @param {Schemas["GraphState"]} state
 * @param {number} run
 * @param {AbortSignal} signal
 */
async function recallOther(model, state, run, signal) {
    for (const name of recalled(model, state)) model.recallOther(await readCurve(name, run, signal));
}

/**
 * Reads figures of the history: service times, delays, signals and places of robots.
 * @param {Model} model
 * @param {Schemas["GraphState"]} state
 * @param {AbortSignal} signal
 */
async function recall(model, state, signal) {
    const curve = (/** @type {string} */ name) => readCurve(name, undefined, signal);
    const names = recalled(model, state);
    // A few at a time: browsers keep six connections to a server, and others want some.
    const queue = names.map((name) => async () => model.recall(await curve(name)));
    for (const robot of model.robots.keys()) {
        queue.push(async () => {
            const [xs, ys] = await Promise.all([curve(`x:${robot}`), curve(`y:${robot}`)]);
            model.recallTrail(robot, xs, ys);
        });
    }
    const worker = async () => {
        for (let job = queue.shift(); job; job = queue.shift()) await job();
    };
    await Promise.all([worker(), worker()]);
}

/**
 * Follows the run until the connection ends. Events that come while the history is read wait for it.
 * @param {AbortController} controller
 */
async function follow(controller) {
    const { signal } = controller;
    /** @type {Stamped[]} */
    const waiting = [];
    /** @type {Model | null} */
    let model = null;
    let missed = 0;
    const tell = () => connection("live", missed > 0 ? `Connected, ${missed} events missed` : "Connected");
    const received = (/** @type {Stamped[]} */ events, /** @type {number} */ lost) => {
        missed += lost;
        if (!model) {
            waiting.push(...events);
            if (waiting.length > MOST_WAITING) missed += waiting.splice(0, waiting.length - MOST_WAITING).length;
            return;
        }
        const began = performance.now();
        for (const event of events) model.take(event);
        frames.events += performance.now() - began;
        if (lost > 0) tell();
        changed();
    };
    /** @type {(opened: Promise<void>) => void} */
    let begin = () => {};
    const opened = new Promise((resolve) => (begin = resolve));
    const stream = api.follow(KINDS, () => begin(Promise.resolve()), received, signal);
    const shown = opened.then(() => load(signal)).then(({ model: read, grid }) => {
        for (const event of waiting.splice(0)) read.take(event);
        model = read;
        show(read, grid);
        tell();
    });
    try {
        await Promise.all([stream, Promise.race([shown, stream])]);
    } finally {
        controller.abort();
    }
}

/** @param {number} seconds */
function pause(seconds) {
    return new Promise((resolve) => setTimeout(resolve, seconds * 1000));
}

/** Returns when the page can be seen. A hidden page reads nothing. */
async function visible() {
    while (document.visibilityState !== "visible") {
        await new Promise((resolve) => document.addEventListener("visibilitychange", resolve, { once: true }));
    }
}

/** Asks for a token, and returns when there is one. */
async function signIn() {
    const dialog = /** @type {HTMLDialogElement} */ (byId("sign-in"));
    const field = /** @type {HTMLInputElement} */ (byId("token"));
    connection("waiting", "Not signed in");
    dialog.showModal();
    await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
    const token = field.value;
    field.value = "";
    if (token) api.signIn(token);
    setText(byId("sign-in-error"), "This token opens nothing here, or was used up.");
}

/** Connects again and again. */
async function run() {
    for (let attempt = 0; ; attempt++) {
        await visible();
        const controller = new AbortController();
        const hidden = () => document.visibilityState === "hidden" && controller.abort();
        document.addEventListener("visibilitychange", hidden);
        const before = views;
        let reason = "the stream ended";
        try {
            await follow(controller);
        } catch (error) {
            if (error instanceof Unauthorized) {
                await signIn();
                attempt = -1;
                continue;
            }
            reason = error instanceof Error ? error.message : String(error);
            if (error instanceof Refused && error.status === 403) reason = `refused: ${error.message}`;
        } finally {
            document.removeEventListener("visibilitychange", hidden);
        }
        if (document.visibilityState === "hidden") {
            connection("waiting", "Paused while hidden");
            continue;
        }
        if (views !== before) attempt = 0;
        const seconds = PAUSES[Math.min(attempt, PAUSES.length - 1)];
        connection("waiting", views ? "The run does not answer; trying again" : `No connection: ${reason}`);
        await pause(seconds);
    }
}

function prepare() {
    const spans = [["30 s", "30"], ["1 min", "60"], ["5 min", "300"], ["All", "all"]];
    const buttons = spans.map(([name, span]) => element("button", {
        type: "button", "data-span": span, "aria-pressed": "false",
        click: () => {
            axis.follow(span === "all" ? null : Number(span));
            changed();
        },
    }, name));
    const hold = element("button", {
        type: "button", "aria-pressed": "true", title: "Follow the present, or hold the charts still (space)",
        click: () => {
            if (axis.isLive) axis.hold(views?.model.now ?? 0);
            else axis.follow();
            changed();
        },
    }, "Live");
    byId("spans").replaceChildren(...buttons, hold);
    document.addEventListener("keydown", (event) => {
        const isField = event.target instanceof HTMLElement && event.target.closest("button, input, select, dialog");
        if (event.key !== " " || isField) return;
        event.preventDefault();
        hold.click();
    });

    const shown = ["Map", "Topology"].map((name) => element("button", {
        type: "button", "aria-pressed": String(name === "Map"),
        click: () => {
            for (const button of shown) button.setAttribute("aria-pressed", String(button.textContent === name));
            setText(byId("map-title"), name);
            for (const id of ["map", "map-tools"]) byId(id).hidden = name !== "Map";
            byId("topology").hidden = name !== "Topology";
            changed();
        },
    }, name));
    byId("views").replaceChildren(...shown);

    const theme = byId("theme");
    const themes = ["system", "light", "dark"];
    const setTheme = (/** @type {string} */ name) => {
        if (name === "system") delete document.documentElement.dataset.theme;
        else document.documentElement.dataset.theme = name;
        setText(theme, `Theme: ${name}`);
        changed();
    };
    let chosen = localStorage.getItem("cotorra-theme") ?? "system";
    setTheme(themes.includes(chosen) ? chosen : "system");
    theme.addEventListener("click", () => {
        chosen = themes[(themes.indexOf(chosen) + 1) % themes.length];
        localStorage.setItem("cotorra-theme", chosen);
        setTheme(chosen);
    });
    dark.addEventListener("change", changed);
}

prepare();
await api.redeem();
await run();
