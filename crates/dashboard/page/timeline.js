// The timeline: what happened, newest first, by group. An entry brings all charts to its time.

import { element } from "./dom.js";
import { clock } from "./format.js";
import { GROUPS } from "./state.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {import("./state.js").Entry} Entry */

/** Entries in the list. Older ones are found by the filter, or on the charts. */
const MOST_SHOWN = 300;

export class Timeline {
    /** @type {Set<string>} */
    #hidden = new Set();
    #words = "";
    #drawn = "";

    /**
     * @param {HTMLElement} list
     * @param {HTMLElement} tools
     * @param {Model} model
     * @param {() => void} changed
     * @param {(entry: Entry) => void} chosen
     */
    constructor(list, tools, model, changed, chosen) {
        list.replaceChildren();
        this.list = list;
        this.model = model;
        this.chosen = chosen;
        const toggles = Object.entries(GROUPS).map(([group, name]) => {
            const toggle = element("button", {
                type: "button", class: "chip", "aria-pressed": "true", "data-group": group,
                click: () => {
                    if (!this.#hidden.delete(group)) this.#hidden.add(group);
                    toggle.setAttribute("aria-pressed", String(!this.#hidden.has(group)));
                    changed();
                },
            }, name);
            return toggle;
        });
        const filter = element("input", {
            type: "search", placeholder: "Filter", "aria-label": "Filter the timeline by words",
            input: (event) => {
                this.#words = /** @type {HTMLInputElement} */ (event.target).value.toLowerCase();
                changed();
            },
        });
        tools.replaceChildren(...toggles, filter);
    }

    draw() {
        const state = [this.model.version.entries, [...this.#hidden], this.#words].join();
        if (state === this.#drawn) return;
        this.#drawn = state;
        const shown = filtered(this.model.entries, this.#hidden, this.#words).slice(-MOST_SHOWN).reverse();
        // Rows that stay are moved, not made anew, so that the keyboard's focus stays, too.
        const there = new Map([...this.list.children].map((row) => [row.getAttribute("data-number"), row]));
        const rows = shown.map((entry) => there.get(String(entry.number)) ?? this.#row(entry));
        const empty = this.model.entries.length > 0 ? "Nothing matches the filter." : "Nothing happened yet.";
        const all = rows.length > 0 ? rows : [element("li", { class: "empty" }, empty)];
        const same = this.list.children.length === all.length && all.every((row, i) => this.list.children[i] === row);
        if (same) return;
        const focused = document.activeElement;
        this.list.replaceChildren(...all);
        if (focused instanceof HTMLElement && this.list.contains(focused)) focused.focus();
    }

    /** @param {Entry} entry */
    #row(entry) {
        const button = element("button", { type: "button", click: () => this.chosen(entry) },
            element("time", {}, clock(entry.at, 1)),
            element("span", { class: "what" }, entry.title),
            element("span", { class: "why" }, entry.detail));
        return element("li", { "data-number": entry.number, "data-group": entry.group, "data-bad": entry.bad }, button);
    }
}

/**
 * Returns the entries that the filter shows.
 * @param {Entry[]} entries
 * @param {Set<string>} hidden
 * @param {string} words
 */
export function filtered(entries, hidden, words) {
    return entries.filter(({ group, title, detail }) =>
        !hidden.has(group) && (words === "" || `${title} ${detail}`.toLowerCase().includes(words)));
}
