// The lidar's last turn on the map, on demand.

import { element } from "./dom.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {{ x: number, y: number }} Point */

/** Pause between two turns that are read, ms. */
const PAUSE = 200;

/**
 * Decodes a `sensor_msgs/LaserScan` of ROS 2 in little-endian CDR: the points that the rays hit, in metres in the lidar's frame.
 * Rays without an echo are left out.
 * @param {Uint8Array} bytes
 * @returns {Point[]}
 */
export function decode(bytes) {
    if (bytes.length < 4 || bytes[1] !== 1) throw new Error("this scan is not in little-endian CDR");
    // Alignment counts from behind the encapsulation's header of four bytes.
    const view = new DataView(bytes.buffer, bytes.byteOffset + 4, bytes.length - 4);
    const frame = 8;
    let at = frame + 4 + view.getUint32(frame, true);
    at += (4 - (at % 4)) % 4;
    const [first, step] = [view.getFloat32(at, true), view.getFloat32(at + 8, true)];
    const [nearest, farthest] = [view.getFloat32(at + 20, true), view.getFloat32(at + 24, true)];
    const count = view.getUint32(at + 28, true);
    /** @type {Point[]} */
    const points = [];
    for (let ray = 0; ray < count; ray++) {
        const range = view.getFloat32(at + 32 + 4 * ray, true);
        if (!(range >= nearest && range <= farthest)) continue;
        const angle = first + ray * step;
        points.push({ x: range * Math.cos(angle), y: range * Math.sin(angle) });
    }
    return points;
}

/** A button that shows the scans of the robot with the focus while it is pressed. */
export class ScanButton {
    #timer = 0;

    /**
     * @param {HTMLElement} tools
     * @param {Model} model
     * @param {() => string | null} focus
     * @param {(path: string) => Promise<Uint8Array>} read
     * @param {(robot: string, points: Point[]) => void} show
     */
    constructor(tools, model, focus, read, show) {
        this.focus = focus;
        this.read = read;
        this.show = show;
        /** Lidars of robots. @type {Map<string, string>} */
        this.lidars = new Map();
        for (const node of model.testbed.graph.nodes) {
            if (node.kind !== "robot") continue;
            const lidar = node.sensors?.find(({ kind }) => kind === "lidar");
            if (lidar) this.lidars.set(node.id, lidar.sensor);
        }
        if (this.lidars.size === 0) return;
        this.button = element("button", {
            type: "button", "aria-pressed": "false", title: "Show the lidar's last turn", click: () => this.#toggle(),
        }, "Scan");
        tools.append(this.button);
    }

    #toggle() {
        const is = this.button?.getAttribute("aria-pressed") !== "true";
        this.button?.setAttribute("aria-pressed", String(is));
        clearTimeout(this.#timer);
        if (is) void this.#next();
        else this.show("", []);
    }

    async #next() {
        const robot = this.focus() ?? [...this.lidars.keys()][0];
        const lidar = this.lidars.get(robot);
        try {
            if (lidar) this.show(robot, decode(await this.read(`robots/${robot}/sensors/${lidar}/latest`)));
            else this.show("", []);
        } catch {
            // Nothing is kept yet, or the run has ended: the connection's state says so.
            this.show("", []);
        }
        const isWanted = this.button?.isConnected && this.button.getAttribute("aria-pressed") === "true";
        if (isWanted) this.#timer = setTimeout(() => void this.#next(), PAUSE);
        else this.show("", []);
    }
}
