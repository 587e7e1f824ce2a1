// The table of robots: the map's figures in words, and the choice of the robot that map and charts are about.

import { element, setText } from "./dom.js";
import { figure } from "./format.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {import("./state.js").Robot} Robot */

const COLUMNS = ["Robot", "Radio unit", "Signal", "Server", "Service time", "Speed", "Position"];

export class RobotsTable {
    #drawn = -1;
    /** @type {Map<string, HTMLTableRowElement>} */
    #rows = new Map();

    /**
     * @param {HTMLTableElement} table
     * @param {Model} model
     * @param {(robot: string) => void} focused
     */
    constructor(table, model, focused) {
        this.model = model;
        const head = element("tr", {}, ...COLUMNS.map((name) => element("th", { scope: "col" }, name)));
        const body = element("tbody");
        for (const id of model.robots.keys()) {
            const choose = element("button", { type: "button", class: "link", click: () => focused(id) }, id);
            const cells = COLUMNS.slice(1).map(() => element("td"));
            const row = element("tr", {}, element("th", { scope: "row" }, choose), ...cells);
            this.#rows.set(id, row);
            body.append(row);
        }
        if (model.robots.size === 0) {
            body.append(element("tr", {}, element("td", { colspan: COLUMNS.length }, "This testbed has no robots.")));
        }
        table.replaceChildren(element("thead", {}, head), body);
    }

    /**
     * Shows a model of another time.
     * @param {Model} model
     */
    show(model) {
        this.model = model;
        this.#drawn = -1;
    }

    /** @param {string | null} focus */
    draw(focus) {
        const { version } = this.model;
        for (const [id, row] of this.#rows) row.toggleAttribute("data-focused", id === focus);
        if (version.robots + version.figures === this.#drawn) return;
        this.#drawn = version.robots + version.figures;
        for (const [id, row] of this.#rows) {
            const robot = this.model.robots.get(id);
            if (robot) this.#describe(robot).forEach((text, i) => setText(row.cells[i + 1], text));
        }
    }

    /** @param {Robot} robot */
    #describe(robot) {
        const { context } = robot;
        if (!context) return ["–", "–", "–", "–", "–", "not known yet"];
        const attached = context.attachments.find((attachment) => attachment.attached);
        const services = this.model.testbed.services.filter((service) => service.robot === robot.id);
        const navigation = services.flatMap((service) => service.vnfs).find((vnf) => vnf.program === "navigation");
        const nodes = navigation ? this.model.placements.get(navigation.id)?.join(", ") : undefined;
        const [first] = services;
        const took = first ? this.model.figure(`service_time:${first.id}`).last : NaN;
        const { pose, velocity } = context.sensors;
        const faults = context.health ?? [];
        return [
            attached?.radio_unit ?? "none",
            figure(attached?.signal_dbm, "dBm"),
            nodes ?? "–",
            figure(took, "ms"),
            faults.length > 0 ? faults.join(", ") : robot.finished ? "walk done" : figure(velocity.linear, "m/s"),
            `${pose.x.toFixed(1)}, ${pose.y.toFixed(1)}`.replaceAll("-", "−"),
        ];
    }
}
