// The panel with the actions: a form for each, the call that it makes, and what the run answers.

import { call, curl, paths, python, touches } from "./actions.js";
import { byId, element, setText } from "./dom.js";
import { figure } from "./format.js";
import { instruction } from "./state.js";
import { links, vnfsByNode } from "./topology.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {import("./actions.js").Form} Form */
/** @typedef {import("./actions.js").Call} Call */
/** @typedef {{ x: number, y: number }} Place */
/** @typedef {{ name: string, label: string, options: string[], words?: Record<string, string>, isLong?: true }} Choice */
/** @typedef {{ name: string, label: string, unit: string, required: boolean, value?: string, isRare?: true }} Figure */
/** @typedef {{ key: string, name: string, fields: (Choice | Figure)[], submits: [Form["action"], string][], hint: (form: FormData, model: Model) => string }} Kind */

const WAYS = { forward: "→ from its first end", backward: "← to its first end" };

/**
 * Returns the kinds of actions that a testbed has objects for.
 * @param {Model} model
 * @returns {Kind[]}
 */
export function kinds(model) {
    const { graph, services } = model.testbed;
    const robot = { name: "robot", label: "Robot", options: [...model.robots.keys()] };
    const vnfs = services.flatMap(({ vnfs }) => vnfs).filter(({ pinned_to }) => !pinned_to);
    const hosts = graph.nodes.filter((node) => "capacity" in node && node.capacity.cpus > 0);
    const flies = graph.nodes.some((node) => node.kind === "robot" && node.model === "quadrotor");
    const metres = (/** @type {string} */ name, required = true) => ({ name, label: name, unit: "m", required });
    const offered = Object.fromEntries(paths(model, links(model)).map((path) => [JSON.stringify(path), route(path)]));
    /** @type {Kind[]} */
    const all = [
        {
            key: "attach", name: "Attach", submits: [["attach", "Attach"], ["suggest", "Suggest"], ["scan", "Scan"]], hint: attachment,
            fields: [robot, { name: "radio_unit", label: "Radio unit", options: model.units }],
        },
        {
            key: "place", name: "Place", submits: [["place", "Place"]], hint: placement,
            fields: [{ name: "vnf", label: "VNF", options: vnfs.map(({ id }) => id) }, { name: "node", label: "Node", options: hosts.map(({ id }) => id) }],
        },
        {
            key: "send", name: "Send", submits: [["send", "Send"], ["return", "Back to its walk"]],
            hint: () => "Click the map to choose the goal.", fields: [robot, metres("x"), metres("y"), ...(flies ? [metres("z", false)] : [])],
        },
        {
            key: "halt", name: "Halt", submits: [["halt", "Halt"], ["go", "Go on"], ["limit", "Limit speed"]], hint: motion,
            fields: [robot, { name: "speed_limit_mps", label: "Speed limit", unit: "m/s", required: false }],
        },
        {
            key: "condition", name: "Link", submits: [["condition", "Change"]], hint: conditions,
            fields: [
                { name: "link", label: "Link", options: links(model).map(({ id }) => id) },
                { name: "direction", label: "Direction", options: ["", "forward", "backward"], words: { "": "both", ...WAYS } },
                { name: "delay_ms", label: "Delay", unit: "ms", required: false },
                { name: "loss_percent", label: "Loss", unit: "%", required: false },
                { name: "rate_mbps", label: "Rate", unit: "Mbit/s", required: false },
                { name: "jitter_ms", label: "Jitter", unit: "ms", required: false, isRare: true },
                { name: "delay_scale", label: "Delay × ψ", unit: "", required: false, isRare: true },
                { name: "drop_scale", label: "Rate ÷ δ", unit: "", required: false, isRare: true },
            ],
        },
        {
            key: "map", name: "Path", submits: [["map", "Map"]], hint: mapping,
            fields: [{ name: "path", label: "Path", options: Object.keys(offered), words: offered, isLong: true }],
        },
        {
            key: "test", name: "Test", submits: [["test", "Test throughput"]], hint: () => "Packets cross the link beside all others.",
            fields: [
                { name: "link", label: "Link", options: graph.links.map(({ id }) => id) },
                { name: "direction", label: "Direction", options: ["forward", "backward"], words: WAYS },
                { name: "seconds", label: "Duration", unit: "s", required: true, value: "1" },
            ],
        },
    ];
    return all.filter(({ fields }) => fields.every((field) => !("options" in field) || field.options.length > 0));
}

/** @type {Kind["hint"]} */
function attachment(form, model) {
    const found = model.robots.get(String(form.get("robot")))?.context?.attachments ?? [];
    const to = found.find(({ attached }) => attached);
    const other = found.find(({ radio_unit }) => radio_unit === form.get("radio_unit"));
    const age = other?.signal_age_ms;
    const heard = figure(other?.signal_dbm, "dBm") + (age ? `, ${(age / 1e3).toFixed(1)} s ago` : "");
    const now = to ? `Attached to ${to.radio_unit}, ${figure(to.signal_dbm, "dBm")}.` : "Not attached.";
    return to?.radio_unit === form.get("radio_unit") ? now : `${now} ${form.get("radio_unit")}: ${heard}.`;
}

/** @type {Kind["hint"]} */
function placement(form, model) {
    const vnf = String(form.get("vnf"));
    return `${vnf} is on ${model.placements.get(vnf)?.join(", ") ?? "no node yet"}.`;
}

/** @type {Kind["hint"]} */
function motion(form, model) {
    const context = model.robots.get(String(form.get("robot")))?.context;
    if (!context) return "";
    const limit = context.speed_limit_mps;
    const limited = limit === null || limit === undefined ? "" : `, limited to ${figure(limit, "m/s")}`;
    return `It moves at ${figure(context.sensors.velocity.linear, "m/s")}${limited}. An empty field lifts the limit.`;
}

/**
 * Returns a path in words.
 * @param {import("./actions.js").Path} path
 */
const route = ({ from, to, links: over }) => `${from} → ${to}: ${over.join(", ") || "the shortest"}`;

/** @type {Kind["hint"]} */
function mapping(form, model) {
    const path = form.get("path");
    if (!path) return "";
    const { from, to } = JSON.parse(String(path));
    const isOn = (/** @type {string} */ vnf, /** @type {string} */ node) => vnfsByNode(model).get(node)?.includes(vnf);
    const now = [...model.virtualLinks.values()].find((one) => isOn(one.from, from) && isOn(one.to, to));
    return now ? `Now over ${now.links.join(", ")} (${now.path ?? "shortest"}). The way back keeps its path.` : "The way back keeps its path.";
}

/** @type {Kind["hint"]} */
function conditions(form, model) {
    const words = ["forward", "backward"].map((direction) => {
        const now = model.links.get(`${form.get("link")}:${direction}`)?.effective;
        if (!now) return "";
        const { loss, rate, jitter } = now;
        const share = loss && "share" in loss ? loss.share : 0;
        const speed = rate?.kind === "fixed" ? figure(rate.rate_bps, "bit/s") : (rate?.kind ?? "unlimited");
        return `${direction === "forward" ? "→" : "←"} ${figure(now.delay_ms, "ms")}${jitter ? ` ± ${figure(jitter.deviation_ms)}` : ""}, ${figure(share * 100, "%")} loss, rate ${speed}`;
    });
    return `${words.filter(Boolean).join("; ")}. An empty field leaves the present figure.`.replace(/^\. /, "");
}

export class ActionPanel {
    /** @type {Model | null} */
    #model = null;
    /** @type {Kind | null} */
    #kind = null;
    /** The button whose call is shown. @type {Form["action"]} */
    #action = "attach";
    #language = curl;
    /** The last test that was started. @type {{ of: string, after: number } | null} */
    #test = null;
    /** The testbed that the forms are about. */
    #known = "";
    #focus = "";

    /**
     * @param {(of: Call) => Promise<unknown>} send
     * @param {(goal: Place | null, picked: ((goal: Place) => void) | null) => void} aim
     */
    constructor(send, aim) {
        this.send = send;
        this.aim = aim;
        this.panel = byId("actions");
        this.opener = byId("act");
        this.form = /** @type {HTMLFormElement} */ (byId("action-form"));
        this.hint = element("p", { class: "hint" });
        this.code = byId("call");
        this.opener.addEventListener("click", () => this.#open(this.panel.hidden));
        byId("actions-close").addEventListener("click", () => this.#open(false));
        this.panel.addEventListener("keydown", (event) => {
            if (event.key === "Escape") this.#open(false);
        });
        this.form.addEventListener("input", () => this.#changed());
        this.form.addEventListener("submit", (event) => {
            event.preventDefault();
            this.#action = /** @type {Form["action"]} */ (event.submitter?.getAttribute("value") ?? this.#action);
            this.#submit();
        });
        const languages = [["curl", curl], ["Python", python]].map(([name, language]) => element("button", {
            type: "button", "aria-pressed": String(language === curl),
            click: ({ currentTarget }) => {
                for (const one of languages) one.setAttribute("aria-pressed", String(one === currentTarget));
                this.#language = /** @type {typeof curl} */ (language);
                this.#changed();
            },
        }, String(name)));
        byId("languages").replaceChildren(...languages);
        byId("copy").addEventListener("click", () => this.#copy());
    }

    /**
     * Offers the actions of a run; none if it follows no instructions.
     * @param {Model} model
     */
    show(model) {
        this.#model = model;
        this.opener.hidden = !model.testbed.steerable;
        if (!model.testbed.steerable) this.#open(false);
        const known = JSON.stringify([model.testbed.graph, model.testbed.services]);
        if (known !== this.#known) {
            this.#known = known;
            this.#test = null;
            const all = kinds(model);
            const buttons = all.map(({ key, name }) => element("button", { type: "button", value: key, click: () => this.#choose(key) }, name));
            byId("action-kinds").replaceChildren(...buttons);
            this.#choose(all[0]?.key);
        } else this.#changed();
    }

    /**
     * Opens the form of a VNF or a link.
     * @param {{ vnf: string } | { link: string }} what
     */
    choose(what) {
        const [[name, value]] = Object.entries(what);
        const key = name === "vnf" ? "place" : "condition";
        const kind = this.#model?.testbed.steerable ? kinds(this.#model).find((kind) => kind.key === key) : undefined;
        // A VNF that cannot move is not among the choices.
        if (!kind?.fields.some((field) => field.name === name && "options" in field && field.options.includes(value))) return;
        this.#choose(key);
        /** @type {HTMLSelectElement} */ (this.#field(name)).value = value;
        this.#open(true);
        this.#changed();
    }

    /**
     * Brings figures and the robot in the form up to date.
     * @param {string | null} focus
     */
    draw(focus) {
        if (this.panel.hidden || !this.#model) return;
        if (focus && focus !== this.#focus) {
            this.#focus = focus;
            this.#chooseRobot();
        }
        if (this.#kind) setText(this.hint, this.#kind.hint(new FormData(this.form), this.#model));
        const tested = this.#test && this.#model.tests.get(this.#test.of);
        if (!this.#test || !tested || tested.at <= this.#test.after) return;
        const { throughput_bps, offered_bps } = tested;
        const all = throughput_bps >= offered_bps * 0.999 ? " It may carry more." : "";
        this.#tell(`${this.#test.of.replace(":", " ")}: ${figure(throughput_bps, "bit/s")} of ${figure(offered_bps, "bit/s")} arrived.${all}`);
        this.#test = null;
    }

    /** @param {boolean} open */
    #open(open) {
        const before = this.panel.hidden;
        this.panel.hidden = !open;
        this.opener.setAttribute("aria-expanded", String(open));
        this.#aim();
        if (open) {
            this.draw(this.#focus);
            /** @type {HTMLElement | null} */ (byId("action-kinds").querySelector("[aria-pressed=true]"))?.focus();
        } else if (!before) this.opener.focus();
    }

    /**
     * Shows the form of a kind, with the links that there are now.
     * @param {string | undefined} key
     */
    #choose(key) {
        const kind = (this.#model && kinds(this.#model).find((kind) => kind.key === key)) ?? null;
        this.#kind = kind;
        for (const button of byId("action-kinds").children) button.setAttribute("aria-pressed", String(button.getAttribute("value") === kind?.key));
        this.form.replaceChildren();
        this.#tell(kind ? "" : "Nothing here can be steered.");
        if (!kind) return;
        const fields = (/** @type {boolean} */ isRare) => kind.fields.filter((field) => "isRare" in field === isRare)
            .map((field) => element("label", { class: "isLong" in field && "long" }, element("span", {}, field.label), control(field)));
        const buttons = kind.submits.map(([action, name], i) => {
            const show = () => {
                this.#action = action;
                this.#changed();
            };
            return element("button", {
                type: "submit", value: action, class: i === 0 ? "primary" : null, formnovalidate: i > 0, focus: show, pointerenter: show,
            }, name);
        });
        const rare = fields(true);
        const more = rare.length > 0 ? [element("details", {}, element("summary", {}, "More"), ...rare)] : [];
        this.form.append(...fields(false), ...more, this.hint, element("div", { class: "buttons" }, ...buttons));
        this.#action = kind.submits[0][0];
        this.#chooseRobot();
        this.draw(this.#focus);
    }

    #chooseRobot() {
        const robot = this.#field("robot");
        if (robot instanceof HTMLSelectElement && [...robot.options].some(({ value }) => value === this.#focus)) robot.value = this.#focus;
        this.#changed();
    }

    /** @param {string} name */
    #field(name) {
        return this.form.elements.namedItem(name);
    }

    /** Shows the call of the form as it is now, and the goal on the map. */
    #changed() {
        const form = this.#read();
        setText(this.code, form ? this.#language(call(form), location.origin) : "Fill in the form to see its call.");
        this.#aim();
    }

    #aim() {
        if (this.panel.hidden || this.#kind?.key !== "send") {
            this.aim(null, null);
            return;
        }
        const [x, y] = ["x", "y"].map((name) => /** @type {HTMLInputElement} */ (this.#field(name)));
        const goal = x.value && y.value ? { x: Number(x.value), y: Number(y.value) } : null;
        this.aim(goal, (picked) => {
            [x.value, y.value] = [picked.x.toFixed(2), picked.y.toFixed(2)];
            this.#action = "send";
            this.#changed();
        });
    }

    /** Returns the form; `null` while a field that it needs is empty. */
    #read() {
        const data = new FormData(this.form);
        const fields = this.#kind?.fields ?? [];
        const isFree = this.#action === "return";
        const is = (/** @type {Choice | Figure} */ field) => isFree || "options" in field || !field.required || data.get(field.name);
        if (fields.length === 0 || !fields.every(is)) return null;
        const values = fields.map((field) => {
            const text = String(data.get(field.name));
            return [field.name, text === "" ? null : "options" in field ? text : Number(text)];
        });
        return /** @type {Form} */ ({ z: null, ...Object.fromEntries(values), action: this.#action });
    }

    async #submit() {
        this.#changed();
        const form = this.#read();
        const model = this.#model;
        if (!form || !model) return;
        const real = touches(model.testbed, form);
        if (real.length > 0 && !(await confirmed(real))) {
            this.#tell("Nothing was done.");
            return;
        }
        const given = call(form);
        this.#test = null;
        this.#tell("Asking …");
        const after = model.now;
        try {
            await this.send(given);
        } catch (error) {
            // An exception of `fetch` is no answer of the run.
            this.#tell(error instanceof TypeError ? "The run does not answer." : `Refused: ${error instanceof Error ? error.message : error}`, true);
            return;
        }
        if (form.action === "test") this.#test = { of: `${form.link}:${form.direction}`, after };
        this.#tell(this.#test ? "Testing …" : `Done: ${instruction(given.body.instruction)}.`);
    }

    /**
     * @param {string} text
     * @param {boolean} [bad]
     */
    #tell(text, bad = false) {
        setText(byId("action-done"), bad ? "" : text);
        setText(byId("action-refused"), bad ? text : "");
    }

    async #copy() {
        getSelection()?.selectAllChildren(this.code);
        // Only secure origins have a clipboard; elsewhere the text is selected.
        const copied = await navigator.clipboard?.writeText(this.code.textContent ?? "").then(() => true, () => false);
        setText(byId("copy"), copied ? "Copied" : "Selected");
        setTimeout(() => setText(byId("copy"), "Copy"), 2000);
    }
}

/** @param {Choice | Figure} field */
function control(field) {
    if ("options" in field) {
        const { name, options, words } = field;
        return element("select", { name }, ...options.map((value) => element("option", { value }, words?.[value] ?? value)));
    }
    const { name, required, value, unit } = field;
    const input = element("input", { name, type: "number", step: "any", required, value: value ?? null, autocomplete: "off" });
    return element("span", { class: "figure" }, input, element("span", { class: "unit" }, unit));
}

/**
 * Asks whether real things may be touched.
 * @param {string[]} real
 */
async function confirmed(real) {
    const dialog = /** @type {HTMLDialogElement} */ (byId("confirm"));
    byId("confirm-what").replaceChildren(...real.map((words) => element("li", {}, words)));
    dialog.returnValue = "";
    dialog.showModal();
    await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
    return dialog.returnValue === "yes";
}
