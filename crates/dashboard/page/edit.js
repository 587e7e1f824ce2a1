// The editor of a testbed file: checks the text as it is typed, completes it, and draws the testbed. Only Save writes.

import { Refused, Api } from "./api.js";
import { declared, locate, suggest } from "./complete.js";
import { byId, element, setText } from "./dom.js";
import { MapView } from "./map.js";
import { palette } from "./palette.js";
import { read } from "./pgm.js";
import { Model } from "./state.js";
import { Topology } from "./topology.js";

/** @typedef {import("#api").components["schemas"]} Schemas */
/** @typedef {{ name: string, text: string, version: number, schema: import("./complete.js").Schema }} File */
/** @typedef {{ start: number, end: number, line: number, message: string, shown: string }} Mistake */
/** @typedef {{ overview: string, mistakes: Mistake[], testbed: Schemas["TestbedBody"] | null, map: Schemas["MapBody"] | null }} Checked */

/** Pause in typing after which the text is checked, ms. */
const PAUSE = 250;
const FILE = "/api/v1/editor";
const CHECK = "/api/v1/editor/check";

const api = new Api();
const dark = matchMedia("(prefers-color-scheme: dark)");
const field = /** @type {HTMLTextAreaElement} */ (byId("text"));
const mirror = byId("mirror");
const choices = byId("choices");
const saveButton = /** @type {HTMLButtonElement} */ (byId("save"));

/** The file as it was last read or saved. @type {File} */
let file = { name: "", text: "", version: 0, schema: {} };
/** @type {Mistake[]} */
let mistakes = [];
/** @type {{ map: MapView, topology: Topology } | null} */
let views = null;
/** The testbed in the views, as JSON. */
let shown = "";
let wanted = false;

function changed() {
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(() => {
        wanted = false;
        const colours = palette(dark.matches);
        views?.map.draw(colours, null);
        views?.topology.draw(colours);
    });
}

/** @param {string} text */
function tell(text) {
    setText(byId("saved"), text);
}

function isDirty() {
    return field.value !== file.text;
}

/** Draws the text below the field, with the mistakes marked. Both have the same letters in the same places. */
function reflect() {
    const text = field.value;
    /** @type {(Node | string)[]} */
    const parts = [];
    let at = 0;
    for (const { start, end } of [...mistakes].sort((a, b) => a.start - b.start)) {
        if (start < at || start > text.length) continue;
        parts.push(text.slice(at, start));
        parts.push(element("mark", {}, text.slice(start, Math.max(end, start + 1)) || " "));
        at = Math.max(end, start + 1);
    }
    // A line of its own at the end, as the field has one.
    mirror.replaceChildren(...parts, `${text.slice(at)}\n`);
    mirror.scrollTop = field.scrollTop;
    mirror.scrollLeft = field.scrollLeft;
    saveButton.disabled = !isDirty();
    tell(isDirty() ? "Not saved" : "Saved");
}

/** Checks the text: one check at a time, and the last text always. */
const checking = {
    running: false,
    again: false,
    timer: 0,
    soon() {
        clearTimeout(this.timer);
        this.timer = setTimeout(() => this.now(), PAUSE);
    },
    async now() {
        if (this.running) {
            this.again = true;
            return;
        }
        this.running = true;
        const text = field.value;
        try {
            const checked = /** @type {Checked} */ (await api.send({ method: "POST", path: CHECK, body: { text } }));
            if (text === field.value) await show(checked);
        } catch (error) {
            overview("waiting", reason(error));
        } finally {
            this.running = false;
        }
        if (this.again) {
            this.again = false;
            void this.now();
        }
    },
};

/** @param {unknown} error */
function reason(error) {
    if (error instanceof TypeError) return "The editor does not answer: was it ended?";
    return error instanceof Error ? error.message : String(error);
}

/**
 * @param {"live" | "waiting"} state
 * @param {string} text
 */
function overview(state, text) {
    byId("overview").dataset.state = state;
    setText(byId("overview"), text);
}

/** @param {Checked} checked */
async function show(checked) {
    mistakes = checked.mistakes;
    reflect();
    overview(checked.testbed ? "live" : "waiting", checked.overview);
    const items = mistakes.map(({ start, line, message, shown: text }) => element("li", {},
        element("button", { type: "button", class: "link", click: () => go(start) }, `Line ${line}: ${message}`),
        element("pre", {}, text)));
    byId("mistakes").replaceChildren(...(items.length > 0 ? items : [element("li", { class: "none" }, "None")]));
    if (checked.testbed) await draw(checked.testbed, checked.map);
}

/**
 * @param {Schemas["TestbedBody"]} testbed
 * @param {Schemas["MapBody"] | null} map
 */
async function draw(testbed, map) {
    const now = JSON.stringify([testbed, map]);
    if (now === shown) return;
    const grid = map ? { place: map, ...read(await api.bytes("map/image")) } : null;
    shown = now;
    const model = new Model(testbed);
    for (const { vnfs } of testbed.services) {
        for (const { id, node } of vnfs) model.placements.set(id, /** @type {string[]} */ ([node].flat()));
    }
    // New elements, so that nothing of the former views listens any more.
    const [onMap, onTopology] = [element("div", { class: "canvas" }), element("div", { class: "canvas" })];
    byId("map").replaceChildren(onMap);
    byId("topology").replaceChildren(onTopology);
    views = {
        map: new MapView(onMap, byId("map-tools"), model, grid, changed, () => {}),
        topology: new Topology(onTopology, model, changed, (what) => "vnf" in what && goTo(what.vnf)),
    };
    changed();
}

/** @param {number} at */
function go(at) {
    field.focus();
    field.setSelectionRange(at, at);
    const line = field.value.slice(0, at).split("\n").length;
    field.scrollTop = (line - 4) * lineHeight();
}

/**
 * Goes to where a VNF is declared.
 * @param {string} vnf
 */
function goTo(vnf) {
    // Names of VNFs are letters, digits, `_`, `~` and `-`.
    const found = new RegExp(`(^|[\\s{,])${vnf}:`, "m").exec(field.value);
    if (found) go(found.index + found[1].length);
}

function lineHeight() {
    return Number.parseFloat(getComputedStyle(field).lineHeight);
}

/** Completions at the cursor. */
const completions = {
    /** @type {import("./complete.js").Suggestion[]} */
    list: [],
    chosen: 0,
    typed: 0,
    get isOpen() {
        return !choices.hidden;
    },
    /** @param {boolean} asked Whether the user asked for them. */
    open(asked) {
        const before = field.value.slice(0, field.selectionStart);
        const place = field.selectionStart === field.selectionEnd ? locate(before) : null;
        // While typing, they appear from the first letter on.
        this.list = place && (asked || place.typed !== "") ? suggest(file.schema, place, declared(field.value)) : [];
        if (!place || this.list.length === 0) return this.close();
        [this.chosen, this.typed] = [0, place.typed.length];
        const items = this.list.map(({ label, detail }, i) => element("li", {
            id: `choice-${i}`, role: "option", "aria-selected": String(i === 0),
            mousedown: (event) => {
                event.preventDefault();
                this.accept(i);
            },
        }, element("b", {}, label), ` ${detail}`));
        choices.replaceChildren(...items);
        choices.hidden = false;
        this.place(before);
        field.setAttribute("aria-expanded", "true");
        this.choose(0);
    },
    /** @param {string} before */
    place(before) {
        const lines = before.split("\n");
        const style = getComputedStyle(field);
        const width = letterWidth(style.font);
        const top = lines.length * lineHeight() + Number.parseFloat(style.paddingTop) - field.scrollTop;
        const left = (lines[lines.length - 1].length - this.typed) * width + Number.parseFloat(style.paddingLeft) - field.scrollLeft;
        choices.style.top = `${Math.min(top, Math.max(0, field.clientHeight - choices.offsetHeight))}px`;
        choices.style.left = `${Math.max(0, Math.min(left, field.clientWidth - choices.offsetWidth))}px`;
    },
    /** @param {number} i */
    choose(i) {
        this.chosen = (i + this.list.length) % this.list.length;
        for (const [n, item] of [...choices.children].entries()) item.setAttribute("aria-selected", String(n === this.chosen));
        choices.children[this.chosen].scrollIntoView({ block: "nearest" });
        field.setAttribute("aria-activedescendant", `choice-${this.chosen}`);
    },
    /** @param {number} i */
    accept(i) {
        const end = field.selectionStart;
        field.setSelectionRange(end - this.typed, end);
        insert(this.list[i].insert);
        this.close();
    },
    close() {
        choices.hidden = true;
        field.setAttribute("aria-expanded", "false");
        field.removeAttribute("aria-activedescendant");
    },
};

/** @param {string} font */
function letterWidth(font) {
    const on = document.createElement("canvas").getContext("2d");
    if (!on) return 8;
    on.font = font;
    return on.measureText("m".repeat(100)).width / 100;
}

/**
 * Inserts text so that Ctrl+Z takes it back. Browsers have no other way for that.
 * @param {string} text
 */
function insert(text) {
    document.execCommand("insertText", false, text);
}

/** @param {KeyboardEvent} event */
function pressed(event) {
    const { key } = event;
    if (completions.isOpen && ["ArrowDown", "ArrowUp", "Enter", "Tab", "Escape"].includes(key)) {
        event.preventDefault();
        if (key === "ArrowDown") completions.choose(completions.chosen + 1);
        else if (key === "ArrowUp") completions.choose(completions.chosen - 1);
        else if (key === "Escape") completions.close();
        else completions.accept(completions.chosen);
    } else if (key === " " && event.ctrlKey) {
        event.preventDefault();
        completions.open(true);
    } else if (key === "Enter" && !event.ctrlKey) {
        // The next line begins below this one, and deeper after a key without a value.
        const line = field.value.slice(0, field.selectionStart).split("\n").at(-1) ?? "";
        const indent = /^ */.exec(line)?.[0] ?? "";
        event.preventDefault();
        insert(`\n${indent}${/:\s*$/.test(line) ? "  " : ""}`);
    }
}

async function load() {
    file = /** @type {File} */ (await api.get("editor"));
    setText(byId("name"), file.name);
    document.title = `${file.name} · cotorra edit`;
    field.value = file.text;
    field.disabled = false;
    reflect();
    await checking.now();
    document.body.dataset.ready = "";
}

async function save() {
    const text = field.value;
    try {
        const saved = /** @type {{ version: number }} */ (
            await api.send({ method: "PUT", path: FILE, body: { text, version: file.version } }));
        file = { ...file, text, version: saved.version };
        reflect();
    } catch (error) {
        if (error instanceof Refused && error.status === 409) await resolve();
        else tell(reason(error));
    }
}

/** Asks what becomes of the text when the file has changed meanwhile. */
async function resolve() {
    const dialog = /** @type {HTMLDialogElement} */ (byId("conflict"));
    dialog.returnValue = "";
    dialog.showModal();
    await new Promise((done) => dialog.addEventListener("close", done, { once: true }));
    if (dialog.returnValue === "reload") await load();
    if (dialog.returnValue !== "overwrite") return;
    const { version } = /** @type {File} */ (await api.get("editor"));
    file = { ...file, version };
    await save();
}

field.addEventListener("input", () => {
    // Their places hold for the former text only.
    mistakes = [];
    reflect();
    completions.open(false);
    checking.soon();
});
field.addEventListener("keydown", pressed);
field.addEventListener("blur", () => completions.close());
field.addEventListener("scroll", () => {
    mirror.scrollTop = field.scrollTop;
    mirror.scrollLeft = field.scrollLeft;
    completions.close();
});
saveButton.addEventListener("click", () => void save());
document.addEventListener("keydown", (event) => {
    if (event.key !== "s" || !(event.ctrlKey || event.metaKey)) return;
    event.preventDefault();
    void save();
});
addEventListener("beforeunload", (event) => {
    if (isDirty()) event.preventDefault();
});
dark.addEventListener("change", changed);

try {
    await api.redeem();
    await load();
} catch (error) {
    tell(reason(error));
}
