// Completion of a testbed file: where the cursor is in the YAML, and what its JSON Schema allows there. It follows the file's
// indentation and brackets, also while the text is not valid yet.

/** @typedef {string | number} Step A key, or the place in a list. */
/** @typedef {Map<string, string>} Keys The keys of a mapping before the cursor, with their values if they are on one line. */
/**
 * @typedef {object} Place Where a cursor is.
 * @property {{ step: Step, keys: Keys }[]} path From the file's top to what holds the cursor: each step, with the keys beside it.
 * @property {Keys} keys Keys of the mapping whose next key is typed; empty for a value.
 * @property {boolean} isKey Whether a key is typed here, or a value.
 * @property {string} typed What was typed of it.
 */
/** @typedef {{ label: string, insert: string, detail: string }} Suggestion */
/** @typedef {{ name: string, kind: string }} Name A name that the file gives: the kind of a node, `VNF`, `network` or `domain`. */
/**
 * @typedef {object} Schema A part of a JSON Schema.
 * @property {string} [description]
 * @property {string | string[]} [type]
 * @property {Record<string, Schema>} [properties]
 * @property {boolean | Schema} [additionalProperties]
 * @property {Schema} [items]
 * @property {Schema[]} [oneOf]
 * @property {Schema[]} [anyOf]
 * @property {unknown} [const]
 * @property {unknown[]} [enum]
 * @property {unknown[]} [examples]
 * @property {string[]} [required]
 */

/** A key of a mapping at the beginning of a line, with its colon. */
const KEY = /^("[^"]*"|'[^']*'|[^\s"'#{}[\],&*!|>%@-][^:#{}[\],]*?)\s*:(?=\s|$)/;
/** Most suggestions. */
const MOST = 60;

class Frame {
    /**
     * @param {number} indent
     * @param {boolean} isList
     */
    constructor(indent, isList) {
        this.indent = indent;
        this.isList = isList;
        /** The key whose value follows, or `null` between a comma and the next one. @type {string | null} */
        this.key = null;
        this.index = -1;
        /** @type {Keys} */
        this.keys = new Map();
    }

    /** @param {string} key */
    enter(key) {
        this.key = key;
        this.keys.set(key, "");
    }

    /** @param {string} value */
    set(value) {
        if (!this.isList && this.key !== null) this.keys.set(this.key, bare(value));
    }

    step() {
        return { step: this.isList ? this.index : (this.key ?? ""), keys: this.keys };
    }
}

/** @param {string} text */
function bare(text) {
    return text.trim().replace(/^(["'])(.*)\1$/, "$2");
}

/** Follows brackets and braces, over several lines if need be. */
class Flow {
    constructor() {
        /** @type {Frame[]} */
        this.frames = [];
        this.token = "";
        this.quote = "";
    }

    /** @param {string} text Without the line's end. */
    feed(text) {
        for (let i = 0; i < text.length; i++) {
            const [at, top] = [text[i], this.frames.at(-1)];
            if (this.quote) {
                if (at === this.quote) this.quote = "";
                this.token += at;
            } else if ((at === '"' || at === "'") && this.token.trim() === "") {
                this.quote = at;
                this.token += at;
            } else if (at === "{" || at === "[") {
                const frame = new Frame(0, at === "[");
                if (frame.isList) frame.index = 0;
                this.frames.push(frame);
                this.token = "";
            } else if (at === "}" || at === "]") {
                top?.set(this.token);
                this.frames.pop();
                this.token = "";
                if (this.frames.length === 0) return;
            } else if (at === "," && top) {
                top.set(this.token);
                top.key = null;
                top.index++;
                this.token = "";
            } else if (at === ":" && top && !top.isList && top.key === null && /^(\s|$)/.test(text.slice(i + 1))) {
                top.enter(bare(this.token));
                this.token = "";
            } else if (at === "#" && /(^|\s)$/.test(text.slice(0, i))) {
                return;
            } else {
                this.token += at;
            }
        }
        this.token += " ";
    }
}

/**
 * Returns where a cursor is, from the text before it; `null` inside a comment or a block of text.
 * @param {string} before
 * @returns {Place | null}
 */
export function locate(before) {
    const lines = before.split("\n");
    /** @type {Frame[]} */
    let frames = [];
    let flow = new Flow();
    for (const [number, line] of lines.entries()) {
        const isLast = number === lines.length - 1;
        if (flow.frames.length > 0) {
            if (isLast && isComment(line)) return null;
            flow.feed(line);
            continue;
        }
        let indent = line.length - line.trimStart().length;
        let content = line.slice(indent);
        if (content.startsWith("#") || /\s#/.test(content)) {
            if (isLast) return null;
            content = content.replace(/(^|\s)#.*$/, "");
        }
        if (content.trim() === "" && !isLast) continue;
        let nested = false;
        for (let item = /^-(\s+|$)/.exec(content); item; item = /^-(\s+|$)/.exec(content)) {
            frames = frames.filter((frame) => frame.indent < indent || (frame.indent === indent && (frame.isList || !nested)));
            let top = frames.at(-1);
            if (!top?.isList || top.indent !== indent) {
                top = new Frame(indent, true);
                frames.push(top);
            }
            top.index++;
            const width = Math.max(item[0].length, 2);
            indent += width;
            content = content.slice(item[0].length);
            nested = true;
        }
        const key = KEY.exec(content);
        // A list may stand below its key without a deeper indentation; the next key ends it.
        frames = frames.filter((frame) => frame.indent < indent || (frame.indent === indent && !frame.isList));
        if (nested) frames = frames.filter((frame) => frame.indent < indent);
        if (!key) {
            if (/^[{[]/.test(content)) {
                flow = new Flow();
                flow.feed(content);
                if (isLast && flow.frames.length > 0) return inFlow(frames, flow);
                continue;
            }
            if (isLast) return open(frames, indent, content, nested);
            continue;
        }
        let top = frames.at(-1);
        if (!top || top.isList || top.indent !== indent) {
            top = new Frame(indent, false);
            frames.push(top);
        }
        top.enter(bare(key[1]));
        const value = content.slice(key[0].length).trimStart();
        if (/^[{[]/.test(value)) {
            flow = new Flow();
            flow.feed(value);
            if (flow.frames.length === 0) continue;
        } else {
            top.set(value);
            if (isLast) return { path: frames.map((frame) => frame.step()), keys: new Map(), isKey: false, typed: value };
        }
    }
    return flow.frames.length > 0 ? inFlow(frames, flow) : null;
}

/** @param {string} line */
function isComment(line) {
    return /(^|\s)#[^"']*$/.test(line);
}

/**
 * A line without a key: one may be typed, or a value of a list.
 * @param {Frame[]} frames
 * @param {number} indent
 * @param {string} typed
 * @param {boolean} isItem
 * @returns {Place}
 */
function open(frames, indent, typed, isItem) {
    const top = frames.at(-1);
    const path = frames.map((frame) => frame.step());
    if (top && !top.isList && top.indent === indent) return { path: path.slice(0, -1), keys: top.keys, isKey: true, typed };
    // Below a key, or in a list: a new mapping begins; in a list, it may be a value, too.
    return { path, keys: new Map(), isKey: true, typed: isItem ? typed.trimEnd() : typed };
}

/**
 * @param {Frame[]} frames
 * @param {Flow} flow
 * @returns {Place | null}
 */
function inFlow(frames, flow) {
    const top = flow.frames.at(-1);
    if (!top) return null;
    const outer = [...frames, ...flow.frames.slice(0, -1)].map((frame) => frame.step());
    const typed = flow.token.replace(/ $/, "").trimStart();
    if (!top.isList && top.key === null) return { path: outer, keys: top.keys, isKey: true, typed };
    return { path: [...outer, top.step()], keys: new Map(), isKey: false, typed };
}

/**
 * Returns the alternatives of a schema, each without others inside.
 * @param {Schema} schema
 * @returns {Schema[]}
 */
function alternatives(schema) {
    const inside = schema.oneOf ?? schema.anyOf;
    return inside ? inside.flatMap((one) => alternatives({ description: schema.description, ...one })) : [schema];
}

/**
 * Leaves out alternatives that these keys contradict.
 * @param {Schema[]} schemas
 * @param {Keys} keys
 */
function fitting(schemas, keys) {
    const fits = schemas.filter(({ properties, additionalProperties }) => [...keys].every(([key, value]) => {
        const of = properties?.[key];
        if (!of) return additionalProperties !== false && properties !== undefined || keys.size === 0;
        const allowed = alternatives(of).flatMap((one) => one.enum ?? (one.const === undefined ? [] : [one.const]));
        return value === "" || allowed.length === 0 || allowed.map(String).includes(value);
    }));
    return fits.length > 0 ? fits : schemas;
}

/**
 * Returns the schemas of what a path leads to.
 * @param {Schema} schema
 * @param {Place["path"]} path
 */
function follow(schema, path) {
    let here = alternatives(schema);
    for (const { step, keys } of path) {
        const next = typeof step === "number"
            ? here.flatMap((one) => (one.items ? [one.items] : []))
            : fitting(here, new Map([...keys].filter(([key]) => key !== step))).flatMap((one) => {
                const others = typeof one.additionalProperties === "object" ? [one.additionalProperties] : [];
                const own = one.properties?.[step];
                return own ? [own] : others;
            });
        here = next.flatMap(alternatives);
    }
    return here;
}

/** @param {Schema} schema */
function values(schema) {
    if (schema.const !== undefined) return [schema.const];
    if (schema.enum) return schema.enum;
    if ([schema.type].flat().includes("boolean")) return [true, false];
    return schema.examples ?? [];
}

/** @param {string | undefined} description */
function sentence(description) {
    return (description ?? "").split(/(?<=[.:])\s/)[0];
}

/**
 * Returns the names that a file gives, by its indentation, also while it is not valid.
 * @param {string} text
 * @returns {Name[]}
 */
export function declared(text) {
    /** @type {Name[]} */
    const names = [];
    /** @type {{ indent: number, key: string }[]} */
    let above = [];
    for (const line of text.split("\n")) {
        const content = line.trimStart();
        const key = KEY.exec(content);
        if (!key) continue;
        const indent = line.length - content.length;
        above = [...above.filter((one) => one.indent < indent), { indent, key: bare(key[1]) }];
        const [top, name, part, inner] = above.map((one) => one.key);
        const value = content.slice(key[0].length).replace(/(^|\s)#.*$/, "");
        const last = names.at(-1);
        if (top === "nodes" && above.length === 2) names.push({ name, kind: /\bkind:\s*(\w+)/.exec(value)?.[1] ?? "node" });
        else if (top === "nodes" && above.length === 3 && part === "kind" && last) last.kind = bare(value);
        else if (top === "services" && above.length === 4 && part === "vnfs") names.push({ name: inner, kind: "VNF" });
        else if (top === "wireless" && above.length === 2) names.push({ name, kind: "network" });
        else if (top === "domains" && above.length === 1) for (const [domain] of value.matchAll(/[\w~-]+/g)) names.push({ name: domain, kind: "domain" });
    }
    return names;
}

/** Kinds of nodes that carry VNFs. */
const HOSTS = ["server", "robot", "radio_unit"];
/** Kinds of names that keys refer to. */
const REFERENCES = new Map(Object.entries({
    ends: [...HOSTS, "switch", "gateway", "machine", "node"],
    node: HOSTS, pinned_to: HOSTS, robot: ["robot"], via: ["machine"], domain: ["domain"], network: ["network"], from: ["VNF"], to: ["VNF"],
}));

/**
 * Returns the kinds of names that can stand at a place.
 * @param {Place} place
 */
function references({ path, isKey }) {
    const keys = path.flatMap(({ step }) => (typeof step === "string" ? [step] : []));
    const key = keys.at(-1) ?? "";
    // The name of a walk is that of its robot, and the only key that refers to something.
    if (isKey && typeof path.at(-1)?.step === "string") return keys.length === 1 && key === "walks" ? ["robot"] : [];
    if (key === "from" && keys.at(-2) === "flow") return HOSTS;
    // Domains and networks of ROS are others.
    if (keys.includes("driver") || keys.includes("offer")) return [];
    return REFERENCES.get(key) ?? [];
}

/**
 * Returns what can stand at a place, the likeliest first.
 * @param {Schema} schema
 * @param {Place} place
 * @param {Name[]} [names] Those that the file gives.
 * @returns {Suggestion[]}
 */
export function suggest(schema, place, names = []) {
    const here = follow(schema, place.path);
    /** @type {Map<string, Suggestion>} */
    const found = new Map();
    const typed = place.typed.replace(/^["']/, "").toLowerCase();
    const add = (/** @type {string} */ label, /** @type {string} */ insert, /** @type {string} */ detail) => {
        if (label.toLowerCase().startsWith(typed) && !found.has(label)) found.set(label, { label, insert, detail });
    };
    const kinds = references(place);
    const suffix = place.isKey && typeof place.path.at(-1)?.step === "string" ? ": " : "";
    for (const { name, kind } of names) if (kinds.includes(kind) && !place.keys.has(name)) add(name, name + suffix, kind);
    if (place.isKey) {
        for (const one of fitting(here, place.keys)) {
            const names = Object.keys(one.properties ?? {}).filter((name) => !place.keys.has(name));
            const isNeeded = (/** @type {string} */ name) => one.required?.includes(name) ?? false;
            names.sort((a, b) => Number(isNeeded(b)) - Number(isNeeded(a)));
            for (const name of names) add(name, `${name}: `, sentence(one.properties?.[name].description));
        }
    }
    if (!place.isKey || typeof place.path.at(-1)?.step === "number") {
        for (const one of here) for (const value of values(one)) {
            if (typeof value !== "object") add(String(value), String(value), sentence(one.description));
        }
    }
    const isAsTyped = (/** @type {Suggestion} */ { label }) => Number(label.startsWith(place.typed));
    return [...found.values()].filter(({ label }) => label !== place.typed).sort((one, other) => isAsTyped(other) - isAsTyped(one)).slice(0, MOST);
}
