// The charts: which figures stand in which, their legends, and how they follow pointer and keyboard. All share one time axis.

import { Canvas, FONT, rimmed } from "./canvas.js";
import { area, draw, Svg } from "./plot.js";
import { DASHES } from "./palette.js";
import { element, rarely, save, setText } from "./dom.js";
import { other, PARTS } from "./state.js";
import { clock, figure } from "./format.js";
import { kept } from "./kept.js";
import { UNITS } from "./units.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {import("./time_axis.js").TimeAxis} TimeAxis */
/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {import("./plot.js").Plot} Plot */
/**
 * @typedef {object} Subject What a chart shows.
 * @property {string} title
 * @property {string} unit
 * @property {number | null} target
 * @property {boolean} fromZero
 * @property {number | null} longestGap
 * @property {boolean} [isOptional] Whether the chart is there only once it has values.
 * @property {(focus: string | null) => { figure: string, name: string }[]} figures At most eight, in a stable order.
 */

/** Until when a chart shows what waits for its turn, ms, if no frame comes before. */
const LATEST = 100;
/** Lines of a chart. There are as many colours. */
const MOST_LINES = 8;
const MOST_MARKS = 400;
/** Compares names: R2 is before R10. */
const BY_NAME = new Intl.Collator("en", { numeric: true });

/**
 * Returns the charts of a testbed.
 * @param {Model} model
 * @returns {Subject[]}
 */
export function subjects(model) {
    /** @type {Map<number | null, string[]>} */
    const byTarget = new Map();
    for (const { id, kpis } of model.testbed.services) {
        const target = kpis.service_time_target_ms ?? null;
        byTarget.set(target, [...(byTarget.get(target) ?? []), id]);
    }
    /** @type {Subject[]} */
    const all = [...byTarget].map(([target, services]) => ({
        title: services.length === 1 ? `Service time of ${services[0]}` : "Service times",
        unit: UNITS.service_time,
        target,
        fromZero: true,
        longestGap: 5,
        figures: () => services.slice(0, MOST_LINES).map((name) => ({ figure: `service_time:${name}`, name })),
    }));
    if (model.testbed.services.length > 0) {
        all.push({
            title: "Split of service time", unit: UNITS.time_part, target: null, fromZero: true, longestGap: 5, isOptional: true,
            figures: (focus) => {
                const its = model.testbed.services.find(({ robot }) => robot === focus) ?? model.testbed.services[0];
                return PARTS.map((name) => ({ figure: `split:${its.id}:${name}`, name }));
            },
        });
    }
    const links = { title: "Delay of links in use", unit: UNITS.delay, target: null, fromZero: true, longestGap: 3 };
    all.push({ ...links, figures: () => usedLinks(model).map((name) => ({ figure: `delay:${name}`, name: named(name) })) });
    if (model.units.length > 0 && model.robots.size > 0) {
        all.push({
            title: "Signal of radio units", unit: UNITS.signal, target: null, fromZero: false, longestGap: 30,
            figures: (focus) => {
                const robot = focus ?? [...model.robots.keys()][0];
                return model.units.slice(0, MOST_LINES).map((unit) => ({ figure: `signal:${robot}:${unit}`, name: unit }));
            },
        });
    }
    if (model.robots.size > 0) {
        all.push({
            title: "Localization error", unit: UNITS.localization_error, target: null, fromZero: true, longestGap: 30, isOptional: true,
            figures: (focus) => {
                const robot = focus ?? [...model.robots.keys()][0];
                return [{ figure: `localization_error:${robot}`, name: robot }];
            },
        });
    }
    const machines = (/** @type {string} */ kind) => () =>
        [...model.machines.keys()].slice(0, MOST_LINES).map((name) => ({ figure: `${kind}:${name}`, name }));
    const ofMachines = { target: null, fromZero: true, longestGap: 10, isOptional: true };
    all.push({ ...ofMachines, title: "Busy CPUs", unit: UNITS.cpu, figures: machines("cpu") });
    all.push({ ...ofMachines, title: "Available memory", unit: UNITS.available_memory, figures: machines("available_memory") });
    return all;
}

/**
 * Returns the directions of links that carry virtual links, in the order of their names: R2 is before R10.
 * @param {Model} model
 */
function usedLinks(model) {
    /** @type {Set<string>} */
    const used = new Set();
    for (const { links } of model.virtualLinks.values()) for (const link of links) used.add(link);
    const directions = [...used].sort(BY_NAME.compare).flatMap((link) => [`${link}:forward`, `${link}:backward`]);
    return directions.filter((of) => Number.isFinite(model.figure(`delay:${of}`).last)).slice(0, MOST_LINES);
}

/** @param {string} link */
const named = (link) => link.replace(":forward", " →").replace(":backward", " ←");

export class Charts {
    #turn = 0;
    #timer = 0;

    /**
     * @param {HTMLElement} host
     * @param {Model} model
     * @param {TimeAxis} axis
     * @param {() => void} changed
     */
    constructor(host, model, axis, changed) {
        host.replaceChildren();
        this.changed = changed;
        /** @type {number | null} */
        this.pinned = null;
        this.all = subjects(model).map((subject) => new Chart(host, subject, model, axis, changed, (at) => this.hover(at)));
    }

    /**
     * Shows the values at a time in all charts; `null` to show none.
     * @param {number | null} at
     */
    hover(at) {
        for (const chart of this.all) chart.hover(at ?? this.pinned);
    }

    /**
     * Shows the values at a time while the pointer is elsewhere; `null` to show the last.
     * @param {number | null} at
     */
    pin(at) {
        this.pinned = at;
        this.hover(null);
    }

    /**
     * Returns the names of all figures in charts.
     * @param {string | null} focus
     */
    figures(focus) {
        return this.all.flatMap((chart) => chart.subject.figures(focus).map(({ figure }) => figure));
    }

    /**
     * Draws what has changed. New samples alone are drawn in turn, half of the charts in a frame.
     * @param {Palette} palette
     * @param {string | null} focus
     */
    draw(palette, focus) {
        this.#turn += 1;
        const drawn = this.all.map((chart, i) => chart.draw(palette, focus, (this.#turn + i) % 2 === 0));
        clearTimeout(this.#timer);
        if (drawn.includes(false)) this.#timer = setTimeout(this.changed, LATEST);
    }
}

class Chart {
    /** Key of the last drawing, so that nothing is drawn twice. */
    #drawn = "";
    /** The samples that were drawn last. */
    #samples = "";
    /** @type {ReturnType<typeof draw> | null} */
    #axes = null;
    /** @type {Plot | null} */
    #plot = null;
    /** @type {Palette | null} */
    #palette = null;
    /** @type {number | null} */
    #hovered = null;
    #tellSoon = rarely(() => this.#tell());
    /** Names of lines that are hidden. @type {Set<string>} */
    #hidden = new Set();
    /** Each line keeps its colour as long as it is there. @type {Map<string, number>} */
    #colours = new Map();

    /**
     * @param {HTMLElement} host
     * @param {Subject} subject
     * @param {Model} model
     * @param {TimeAxis} axis
     * @param {() => void} changed
     * @param {(at: number | null) => void} hoverAll
     */
    constructor(host, subject, model, axis, changed, hoverAll) {
        this.subject = subject;
        this.model = model;
        this.axis = axis;
        this.changed = changed;
        this.legend = element("ul", { class: "legend" });
        const title = subject.unit ? `${subject.title}, ${subject.unit}` : subject.title;
        const saves = [["PNG", () => this.#savePng()], ["SVG", () => this.#saveSvg()], ["CSV", () => this.#saveCsv()]];
        const buttons = saves.map(([name, click]) =>
            element("button", { type: "button", class: "quiet", "aria-label": `Save ${subject.title} as ${name}`, click: /** @type {EventListener} */ (click) }, String(name)));
        const place = element("div", { class: "canvas" });
        this.figure = element("figure", { class: "chart", hidden: subject.isOptional ?? false },
            element("figcaption", {}, element("h2", {}, title), element("div", { class: "tools" }, ...buttons), this.legend), place);
        host.append(this.figure);
        this.canvas = new Canvas(place, subject.title, () => {
            this.#drawn = "";
            changed();
        });
        this.#listen(place, hoverAll);
    }

    /**
     * @param {HTMLElement} place
     * @param {(at: number | null) => void} hoverAll
     */
    #listen(place, hoverAll) {
        const share = (/** @type {MouseEvent} */ event) => {
            const { left, right } = area(this.canvas.width, this.canvas.height);
            return (event.clientX - place.getBoundingClientRect().left - left) / (right - left);
        };
        const timeAt = (/** @type {number} */ at) => {
            const { from, until } = this.axis.window(this.model.now);
            return from + (until - from) * at;
        };
        /** @type {number | null} */
        let held = null;
        place.addEventListener("wheel", (event) => {
            event.preventDefault();
            if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
                this.axis.pan((event.deltaX || event.deltaY) / 800, this.model.now);
            } else this.axis.zoom(Math.exp(event.deltaY / 400), Math.min(1, Math.max(0, share(event))), this.model.now);
            this.changed();
        }, { passive: false });
        place.addEventListener("pointerdown", (event) => {
            if (event.button !== 0) return;
            held = share(event);
            place.setPointerCapture(event.pointerId);
        });
        place.addEventListener("pointermove", (event) => {
            const at = share(event);
            if (held !== null && Math.abs(at - held) > 0.002) {
                this.axis.pan(held - at, this.model.now);
                held = at;
                this.changed();
            }
            hoverAll(at >= 0 && at <= 1 ? timeAt(at) : null);
        });
        place.addEventListener("pointerup", () => (held = null));
        place.addEventListener("pointercancel", () => (held = null));
        place.addEventListener("pointerleave", () => hoverAll(null));
        place.addEventListener("dblclick", () => {
            this.axis.follow(60);
            this.changed();
        });
        this.canvas.base.addEventListener("keydown", (event) => {
            const { now } = this.model;
            /** @type {Record<string, () => void>} */
            const keys = {
                ArrowLeft: () => this.axis.pan(-0.1, now),
                ArrowRight: () => this.axis.pan(0.1, now),
                "+": () => this.axis.zoom(0.7, 0.5, now),
                "-": () => this.axis.zoom(1 / 0.7, 0.5, now),
                Home: () => this.axis.follow(null),
                End: () => this.axis.follow(60),
            };
            const act = keys[event.key];
            if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
            event.preventDefault();
            act();
            this.changed();
        });
    }

    /** @param {string} name */
    #colour(name) {
        let index = this.#colours.get(name);
        if (index === undefined) {
            const used = new Set(this.#colours.values());
            index = Array.from({ length: MOST_LINES }, (_, i) => i).find((i) => !used.has(i)) ?? this.#colours.size % MOST_LINES;
            this.#colours.set(name, index);
        }
        return index;
    }

    /**
     * Returns the figures of this run, each with that of the run that it is compared with.
     * @param {string | null} focus
     */
    #figures(focus) {
        const own = this.subject.figures(focus);
        if (!this.model.isCompared) return own;
        return own.slice(0, MOST_LINES / 2).flatMap(({ figure, name }) => [{ figure, name }, { figure: other(figure), name: `${name}, other run` }]);
    }

    /**
     * @param {string | null} focus
     * @returns {Plot}
     */
    #compose(focus) {
        const { model, subject } = this;
        const { from, until } = this.axis.window(model.now);
        const figures = this.#figures(focus);
        const names = new Set(figures.map(({ name }) => name));
        for (const name of this.#colours.keys()) if (!names.has(name)) this.#colours.delete(name);
        const lines = figures.map(({ figure, name }) => ({ name, series: model.closest(figure, from, until), index: this.#colour(name) }));
        const robot = model.robots.get(focus ?? [...model.robots.keys()][0] ?? "");
        const regions = (robot?.regions ?? []).filter((region) => (region.until ?? model.now) >= from && region.from <= until);
        const bands = regions.map((region) => ({
            from: region.from, until: region.until ?? model.now, index: Math.max(0, model.units.indexOf(region.unit)), name: region.unit,
        }));
        const marked = model.entries.filter((entry) => entry.at >= from && entry.at <= until && entry.group !== "decision");
        const marks = marked.slice(-MOST_MARKS).map(({ at, bad }) => ({ at, bad }));
        const { target, unit, fromZero, longestGap } = subject;
        return { from, until, lines: lines.filter(({ name }) => !this.#hidden.has(name)), bands, marks, target, unit, fromZero, longestGap };
    }

    /**
     * Draws the chart if something in it has changed. Returns whether it shows everything.
     * @param {Palette} palette
     * @param {string | null} focus
     * @param {boolean} isTurn Whether new samples are drawn.
     */
    draw(palette, focus, isTurn) {
        const { version } = this.model;
        if (this.subject.isOptional) {
            const has = (/** @type {{ figure: string }} */ { figure }) => Number.isFinite(this.model.figure(figure).last);
            this.figure.hidden = !this.subject.figures(focus).some(has);
        }
        if (this.canvas.width === 0) return true;
        const { until } = this.axis.window(this.model.now);
        // A window in the past changes only by what the history brings.
        const samples = until < this.model.now - 1 ? "" : [until, version.figures, version.robots].join();
        const { detail } = this.model;
        const state = [this.axis.version, version.entries, detail?.from, detail?.until, palette.dark, focus, [...this.#hidden]].join();
        if (state === this.#drawn && samples === this.#samples) return true;
        if (state === this.#drawn && !isTurn) return false;
        [this.#drawn, this.#samples] = [state, samples];
        this.#palette = palette;
        this.#plot = this.#compose(focus);
        const on = this.canvas.clear(this.canvas.base);
        this.#axes = draw(on, this.canvas.width, this.canvas.height, this.#plot, palette);
        if (this.#hovered !== null) this.hover(this.#hovered);
        else this.#tellSoon();
        return true;
    }

    /** Brings the legend up to date: each line with its colour and its value at the pointer, or its last. */
    #tell() {
        const [plot, palette] = [this.#plot, this.#palette];
        if (!plot || !palette) return;
        const names = [...this.#colours.keys()];
        if (this.legend.children.length !== names.length || [...this.legend.children].some((item, i) => item.getAttribute("data-name") !== names[i])) {
            this.legend.replaceChildren(...names.map((name) => this.#item(name)));
        }
        const words = names.map((name, i) => {
            const line = plot.lines.find((one) => one.name === name);
            const found = line && this.#hovered !== null ? line.series.valueAt(this.#hovered).value : line?.series.last;
            const value = line ? figure(found, this.subject.unit) : "hidden";
            const counts = line && plot.target !== null && this.#hovered === null ? line.series.countWithin(plot.target, plot.from, plot.until) : null;
            const keep = this.model.testbed.services.find(({ id }) => id === name)?.kpis.keep;
            const share = counts && kept(counts, keep);
            const item = this.legend.children[i];
            const swatch = /** @type {SVGLineElement | null} */ (item.querySelector("line"));
            const index = this.#colours.get(name) ?? 0;
            swatch?.setAttribute("stroke", palette.series[index]);
            swatch?.setAttribute("stroke-dasharray", DASHES[index].join(" "));
            setText(/** @type {Element} */ (item.querySelector(".value")), share ? `${value}, ${share}` : value);
            return share && keep ? `${name} ${value}, ${share}` : `${name} ${value}`;
        });
        const units = [...new Set(plot.bands.map((band) => band.name))].join(", ");
        const what = `${this.subject.title}, ${clock(plot.from)} to ${clock(plot.until)}${units && `, attached to ${units}`}`;
        const label = `${what}: ${words.join("; ") || "no figures yet"}`;
        this.canvas.base.setAttribute("aria-label", label);
    }

    /** @param {string} name */
    #item(name) {
        const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
        const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
        for (const [key, value] of Object.entries({ viewBox: "0 0 22 8", width: "22", height: "8", "aria-hidden": "true" })) svg.setAttribute(key, value);
        for (const [key, value] of Object.entries({ x1: "0", y1: "4", x2: "22", y2: "4", "stroke-width": "2" })) line.setAttribute(key, value);
        svg.append(line);
        const toggle = element("button", {
            type: "button", "aria-pressed": String(!this.#hidden.has(name)), title: "Show or hide this line",
            click: () => {
                if (!this.#hidden.delete(name)) this.#hidden.add(name);
                toggle.setAttribute("aria-pressed", String(!this.#hidden.has(name)));
                this.changed();
            },
        }, svg, element("span", {}, name), element("span", { class: "value" }));
        return element("li", { "data-name": name }, toggle);
    }

    /** @param {number | null} at */
    hover(at) {
        this.#hovered = at;
        const [plot, axes, palette] = [this.#plot, this.#axes, this.#palette];
        const on = this.canvas.clear(this.canvas.over);
        if (!plot || !axes || !palette) return;
        if (at !== null && at >= plot.from && at <= plot.until) {
            const x = axes.left + ((at - plot.from) / (plot.until - plot.from)) * (axes.right - axes.left);
            on.strokeStyle = palette.faint;
            on.beginPath();
            on.moveTo(Math.round(x) + 0.5, axes.top);
            on.lineTo(Math.round(x) + 0.5, axes.bottom);
            on.stroke();
            for (const line of plot.lines) {
                const { value } = line.series.valueAt(at);
                if (!Number.isFinite(value)) continue;
                const y = axes.bottom - ((Math.min(value, axes.high) - axes.low) / (axes.high - axes.low)) * (axes.bottom - axes.top);
                on.fillStyle = palette.series[line.index % palette.series.length];
                on.beginPath();
                on.arc(x, y, 3, 0, 2 * Math.PI);
                on.fill();
            }
            on.font = FONT;
            on.textBaseline = "middle";
            on.textAlign = x > (axes.left + axes.right) / 2 ? "right" : "left";
            rimmed(on, clock(at, 2), x + (x > (axes.left + axes.right) / 2 ? -6 : 6), axes.bottom - 8, palette.ink, palette.back);
        }
        this.#tell();
    }

    get #name() {
        return `${this.model.testbed.name} ${this.subject.title}`.toLowerCase().replaceAll(/[^a-z0-9]+/g, "-");
    }

    #savePng() {
        const { base, width, height, density } = this.canvas;
        const picture = element("canvas", { width: base.width, height: base.height });
        const on = picture.getContext("2d");
        if (!on || !this.#plot || !this.#palette) return;
        on.scale(density, density);
        on.fillStyle = this.#palette.back;
        on.fillRect(0, 0, width, height);
        draw(on, width, height, this.#plot, this.#palette);
        picture.toBlob((blob) => blob && save(blob, `${this.#name}.png`));
    }

    #saveSvg() {
        if (!this.#plot || !this.#palette) return;
        const { width, height } = this.canvas;
        const svg = new Svg();
        draw(svg, width, height, this.#plot, this.#palette);
        save(new Blob([svg.text(width, height, this.#palette.back)], { type: "image/svg+xml" }), `${this.#name}.svg`);
    }

    #saveCsv() {
        if (!this.#plot) return;
        save(new Blob([csv(this.#plot)], { type: "text/csv" }), `${this.#name}.csv`);
    }
}

/**
 * Returns what a plot shows as a table: a row for each sample, or for the extremes of a step.
 * @param {Plot} plot
 */
export function csv(plot) {
    const rows = ["at_s,series,min,max,last"];
    const quoted = (/** @type {string} */ text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    for (const { name, series } of plot.lines) {
        series.scan(plot.from, plot.until, (at, low, high, last) => {
            if (at < plot.from || at > plot.until || Number.isNaN(last)) return;
            rows.push([at.toFixed(6), quoted(name), low, high, last].join(","));
        });
    }
    return rows.join("\n") + "\n";
}
