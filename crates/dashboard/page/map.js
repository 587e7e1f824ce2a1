// The map: floor and walls, radio units with their coverage, and robots with their pose, covariance, walk, trail and attachment.

import { Canvas, FONT, rimmed } from "./canvas.js";
import { rings } from "./coverage.js";
import { BANDS, faded } from "./palette.js";
import { element, rarely } from "./dom.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {import("./state.js").Robot} Robot */
/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {import("#api").components["schemas"]["MapBody"]} Place */
/** @typedef {{ place: Place, width: number, height: number, pixels: Uint8Array }} Grid */
/** @typedef {import("./coverage.js").Coverage} Coverage */

/** Pixels to the metre. */
const SMALLEST = 0.5;
const LARGEST = 400;
/** A covariance ellipse holds the robot in 95 of 100 cases: the quantile of χ² with two degrees of freedom. */
const CHI_SQUARED = 5.991;
const MARGIN = 24;
/** Pause between two pictures of the ground in the same view, ms. */
const GROUND_EVERY = 3000;

export class MapView {
    /** Centre of the view in metres, and pixels to the metre; `null` to show all. @type {{x: number, y: number, scale: number} | null} */
    #view = null;
    #follow = false;
    #tellSoon = rarely(() => this.#tell());
    #drawn = "";
    /** @type {{ robot: string, points: {x: number, y: number}[] }} */
    #scan = { robot: "", points: [] };
    /** A goal that somebody chooses. @type {{x: number, y: number} | null} */
    #goal = null;
    /** Gets the place of a click, if one is wanted. @type {((goal: {x: number, y: number}) => void) | null} */
    #picked = null;
    /** The floor in the colours of a palette. @type {{ dark: boolean, picture: HTMLCanvasElement } | null} */
    #floor = null;
    /** @type {{ of: Coverage[], legend: string }} */
    #coverage = { of: [], legend: "" };
    /**
     * Floor, coverage, walks and trails as a picture, and what it shows: time until which it has the trails, and when it was
     * drawn. Without a GPU, they take most of a frame.
     */
    #ground = { view: "", until: -Infinity, at: -Infinity, picture: element("canvas") };
    /** The coverage as a picture, which is drawn anew only for another view. */
    #rings = { view: "", picture: element("canvas") };

    /**
     * @param {HTMLElement} host
     * @param {HTMLElement} tools
     * @param {Model} model
     * @param {Grid | null} grid
     * @param {() => void} changed
     * @param {(robot: string) => void} focused
     */
    constructor(host, tools, model, grid, changed, focused) {
        host.replaceChildren();
        this.model = model;
        /** The model of the present, to which scans belong. */
        this.live = model;
        this.grid = grid;
        this.changed = changed;
        this.focused = focused;
        this.extent = extent(model, grid);
        this.canvas = new Canvas(host, "Map", () => {
            this.#drawn = "";
            changed();
        });
        this.following = element("button", {
            type: "button", "aria-pressed": "false", click: () => this.#setFollow(!this.#follow),
        }, "Follow");
        tools.replaceChildren(
            element("button", { type: "button", "aria-label": "Zoom in", click: () => this.#zoom(1.4) }, "+"),
            element("button", { type: "button", "aria-label": "Zoom out", click: () => this.#zoom(1 / 1.4) }, "−"),
            element("button", { type: "button", click: () => this.#fit() }, "Fit"),
            this.following,
        );
        this.#listen(host);
    }

    /**
     * Shows a model of another time.
     * @param {Model} model
     */
    show(model) {
        this.model = model;
        this.#ground.view = "";
        this.#drawn = "";
    }

    /**
     * Shows what a robot's lidar sees, in the robot's frame.
     * @param {string} robot
     * @param {{x: number, y: number}[]} points
     */
    showScan(robot, points) {
        this.#scan = { robot, points };
        this.#drawn = "";
        this.changed();
    }

    /**
     * Shows the coverage of radio units, and says what it is.
     * @param {Coverage[]} of
     * @param {string} legend
     */
    showCoverage(of, legend) {
        this.#coverage = { of, legend };
        this.#rings.view = this.#ground.view = "";
        this.#drawn = "";
        this.changed();
    }

    /** @param {boolean} follow */
    #setFollow(follow) {
        this.#follow = follow;
        this.following.setAttribute("aria-pressed", String(follow));
        this.#drawn = "";
        this.changed();
    }

    /**
     * Shows a goal, and gives places of clicks to `picked` instead of selecting robots.
     * @param {{x: number, y: number} | null} goal
     * @param {((goal: {x: number, y: number}) => void) | null} picked
     */
    aim(goal, picked) {
        [this.#goal, this.#picked] = [goal, picked];
        this.canvas.base.toggleAttribute("data-aims", picked !== null);
        this.#drawn = "";
        this.changed();
    }

    #fit() {
        this.#view = null;
        this.#setFollow(false);
    }

    /**
     * @param {number} factor
     * @param {{x: number, y: number}} [around] Pixels.
     */
    #zoom(factor, around) {
        const view = this.#shown();
        const scale = Math.min(LARGEST, Math.max(SMALLEST, view.scale * factor));
        const { width, height } = this.canvas;
        const at = around ?? { x: width / 2, y: height / 2 };
        const [dx, dy] = [at.x - width / 2, at.y - height / 2];
        // The place below the pointer stays there.
        this.#view = { x: view.x + dx / view.scale - dx / scale, y: view.y - dy / view.scale + dy / scale, scale };
        this.#drawn = "";
        this.changed();
    }

    /**
     * @param {number} dx
     * @param {number} dy
     */
    #pan(dx, dy) {
        const view = this.#shown();
        this.#view = { x: view.x - dx / view.scale, y: view.y + dy / view.scale, scale: view.scale };
        if (this.#follow) this.#setFollow(false);
        this.#drawn = "";
        this.changed();
    }

    /** @param {HTMLElement} host */
    #listen(host) {
        const place = (/** @type {MouseEvent} */ event) => {
            const box = host.getBoundingClientRect();
            return { x: event.clientX - box.left, y: event.clientY - box.top };
        };
        /** @type {{x: number, y: number} | null} */
        let held = null;
        let moved = false;
        host.addEventListener("wheel", (event) => {
            event.preventDefault();
            this.#zoom(Math.exp(-event.deltaY / 400), this.#follow ? undefined : place(event));
        }, { passive: false });
        host.addEventListener("pointerdown", (event) => {
            if (event.button !== 0) return;
            [held, moved] = [place(event), false];
            host.setPointerCapture(event.pointerId);
        });
        host.addEventListener("pointermove", (event) => {
            if (!held) return;
            const at = place(event);
            if (!moved && Math.hypot(at.x - held.x, at.y - held.y) < 4) return;
            moved = true;
            this.#pan(at.x - held.x, at.y - held.y);
            held = at;
        });
        host.addEventListener("pointerup", (event) => {
            if (held && !moved) this.#select(place(event));
            held = null;
        });
        host.addEventListener("pointercancel", () => (held = null));
        this.canvas.base.addEventListener("keydown", (event) => {
            /** @type {Record<string, () => void>} */
            const keys = {
                ArrowLeft: () => this.#pan(60, 0),
                ArrowRight: () => this.#pan(-60, 0),
                ArrowUp: () => this.#pan(0, 60),
                ArrowDown: () => this.#pan(0, -60),
                "+": () => this.#zoom(1.4),
                "-": () => this.#zoom(1 / 1.4),
                0: () => this.#fit(),
                f: () => this.#setFollow(!this.#follow),
            };
            const act = keys[event.key];
            if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
            event.preventDefault();
            act();
        });
    }

    /** @param {{x: number, y: number}} at */
    #select(at) {
        const { to, from } = this.#transform();
        if (this.#picked) {
            this.#picked(from(at.x, at.y));
            return;
        }
        for (const robot of this.model.robots.values()) {
            const pose = robot.context?.sensors.pose;
            if (!pose) continue;
            const [x, y] = to(pose.x, pose.y);
            if (Math.hypot(at.x - x, at.y - y) < 14) this.focused(robot.id);
        }
    }

    #shown() {
        if (this.#view) return this.#view;
        const { width, height } = this.canvas;
        const { left, right, bottom, top } = this.extent;
        const scale = Math.min((width - 2 * MARGIN) / (right - left), (height - 2 * MARGIN) / (top - bottom));
        return { x: (left + right) / 2, y: (bottom + top) / 2, scale: Math.min(LARGEST, Math.max(SMALLEST, scale)) };
    }

    #transform() {
        const { x, y, scale } = this.#shown();
        const { width, height } = this.canvas;
        return {
            scale,
            /** @type {(px: number, py: number) => [number, number]} */
            to: (px, py) => [width / 2 + (px - x) * scale, height / 2 - (py - y) * scale],
            from: (/** @type {number} */ px, /** @type {number} */ py) => ({ x: x + (px - width / 2) / scale, y: y - (py - height / 2) / scale }),
        };
    }

    /**
     * Draws the map if something on it has changed.
     * @param {Palette} palette
     * @param {string | null} focus
     */
    draw(palette, focus) {
        if (this.canvas.width === 0) return;
        const followed = this.model.robots.get(focus ?? [...this.model.robots.keys()][0] ?? "")?.context?.sensors.pose;
        if (this.#follow && followed) {
            const { scale } = this.#shown();
            this.#view = { x: followed.x, y: followed.y, scale: Math.max(scale, 12) };
        }
        const state = [this.model.version.robots, this.model.version.entries, palette.dark, focus].join();
        if (state === this.#drawn) return;
        this.#drawn = state;
        const on = this.canvas.clear(this.canvas.base);
        const { scale, to } = this.#transform();
        this.#drawGround(on, to, scale, palette);
        begin(on);
        for (const robot of this.model.robots.values()) this.#drawAttachment(on, to, robot, palette);
        this.#drawUnits(on, to, palette);
        this.#drawScan(on, to, palette);
        for (const robot of this.model.robots.values()) this.#drawRobot(on, to, scale, robot, palette, robot.id === focus);
        if (this.#goal) this.#drawGoal(on, ...to(this.#goal.x, this.#goal.y), palette);
        this.#drawScale(on, scale, palette);
        this.#tellSoon();
    }

    /**
     * Draws what lies on the ground: as a picture, and what robots went since.
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {number} scale
     * @param {Palette} palette
     */
    #drawGround(on, to, scale, palette) {
        const ground = this.#ground;
        const { base, density, width, height } = this.canvas;
        const view = [...to(0, 0), scale, width, height, density, palette.dark].join();
        const now = performance.now();
        if (view !== ground.view || now - ground.at > GROUND_EVERY) {
            const { picture } = ground;
            // A size clears it.
            [picture.width, picture.height] = [base.width, base.height];
            const layer = picture.getContext("2d");
            if (!layer) return;
            layer.scale(density, density);
            begin(layer);
            this.#drawFloor(layer, to, scale, palette);
            this.#drawCoverage(layer, to, scale, palette);
            for (const walk of this.model.testbed.walks) this.#drawWalk(layer, to, walk.waypoints, palette);
            for (const robot of this.model.robots.values()) this.#drawTrail(layer, to, robot, palette, -Infinity);
            [ground.view, ground.until, ground.at] = [view, this.model.now, now];
        }
        on.drawImage(ground.picture, 0, 0, width, height);
        for (const robot of this.model.robots.values()) this.#drawTrail(on, to, robot, palette, ground.until);
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {number} scale
     * @param {Palette} palette
     */
    #drawFloor(on, to, scale, palette) {
        if (!this.grid) return;
        if (this.#floor?.dark !== palette.dark) this.#floor = { dark: palette.dark, picture: floor(this.grid, palette) };
        const { resolution_m: cell, origin, width, height } = this.grid.place;
        const [left, top] = to(origin.x, origin.y + height * cell);
        on.imageSmoothingEnabled = cell * scale < 4;
        on.drawImage(this.#floor.picture, left, top, width * cell * scale, height * cell * scale);
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {number} scale
     * @param {Palette} palette
     */
    #drawCoverage(on, to, scale, palette) {
        const { of, legend } = this.#coverage;
        const { base, density, width, height } = this.canvas;
        if (of.length > 0) {
            const { picture } = this.#rings;
            const view = [...to(0, 0), scale, width, height, density, palette.dark].join();
            if (view !== this.#rings.view) {
                this.#rings.view = view;
                // A new size clears it.
                [picture.width, picture.height] = [base.width, base.height];
                const layer = picture.getContext("2d");
                layer?.scale(density, density);
                if (layer) this.#drawRings(layer, to, scale, palette);
            }
            on.drawImage(picture, 0, 0, width, height);
        }
        if (!legend) return;
        on.textAlign = "left";
        rimmed(on, legend, 12, 14, palette.faint, palette.back);
        on.textAlign = "center";
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {number} scale
     * @param {Palette} palette
     */
    #drawRings(on, to, scale, palette) {
        const place = (/** @type {string} */ unit) => {
            const at = this.model.nodes.get(unit)?.position;
            if (!at) return null;
            const [x, y] = to(at.x, at.y);
            return { x, y };
        };
        const all = rings(this.#coverage.of, place, scale, this.canvas);
        on.lineWidth = 1;
        for (const { unit, x, y, radius } of all) {
            const colour = this.#colour(unit);
            on.beginPath();
            on.arc(x, y, radius, 0, 2 * Math.PI);
            on.fillStyle = faded(colour, 0.06);
            on.fill();
            on.strokeStyle = faded(colour, 0.8);
            on.stroke();
        }
        on.font = FONT;
        on.textBaseline = "middle";
        on.textAlign = "center";
        for (const { signal, label } of all) {
            if (label) rimmed(on, signal.toFixed(0).replace("-", "−"), label.x, label.y, palette.faint, palette.back);
        }
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {{x: number, y: number}[]} waypoints
     * @param {Palette} palette
     */
    #drawWalk(on, to, waypoints, palette) {
        on.strokeStyle = palette.faint;
        on.lineWidth = 1;
        on.setLineDash([3, 4]);
        on.beginPath();
        for (const point of waypoints) on.lineTo(...to(point.x, point.y));
        on.stroke();
        on.setLineDash([]);
    }

    /**
     * Draws where a robot went after a time.
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {Robot} robot
     * @param {Palette} palette
     * @param {number} since
     */
    #drawTrail(on, to, robot, palette, since) {
        const next = robot.trail.findLastIndex(({ at }) => at <= since) + 1;
        const trail = robot.trail.slice(Math.max(0, next - 1));
        if (trail.length < 2) return;
        on.lineJoin = "round";
        // A rim, so that yellow can be seen on a light floor. It begins flat, to leave what is there as it is.
        on.lineWidth = 5.5;
        on.strokeStyle = palette.wall;
        on.beginPath();
        for (const { x, y } of trail) on.lineTo(...to(x, y));
        on.stroke();
        on.lineWidth = 3.5;
        on.lineCap = "round";
        let region = 0;
        let open = false;
        const colour = (/** @type {string} */ unit) => this.#colour(unit);
        let [beforeX, beforeY] = [NaN, NaN];
        for (const [i, { x, y, at }] of trail.entries()) {
            const [px, py] = to(x, y);
            const isEnd = i === trail.length - 1 || (robot.regions[region]?.until ?? Infinity) < at;
            if (!isEnd && Math.abs(px - beforeX) + Math.abs(py - beforeY) < 3) continue;
            [beforeX, beforeY] = [px, py];
            while (region < robot.regions.length && (robot.regions[region].until ?? Infinity) < at) {
                if (open) {
                    on.lineTo(px, py);
                    on.stroke();
                }
                [region, open] = [region + 1, false];
            }
            if (!open) {
                on.beginPath();
                on.strokeStyle = region < robot.regions.length ? colour(robot.regions[region].unit) : faded("#999999", 0.8);
                open = true;
            }
            on.lineTo(px, py);
        }
        if (open) on.stroke();
        on.lineCap = "butt";
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {Palette} palette
     */
    #drawScan(on, to, palette) {
        const pose = this.model.robots.get(this.#scan.robot)?.context?.sensors.pose;
        if (!pose || this.model !== this.live) return;
        const [cos, sin] = [Math.cos(pose.heading), Math.sin(pose.heading)];
        on.fillStyle = palette.alert;
        for (const { x, y } of this.#scan.points) {
            const [px, py] = to(pose.x + x * cos - y * sin, pose.y + x * sin + y * cos);
            on.fillRect(px - 1, py - 1, 2, 2);
        }
    }

    /** @param {string} unit */
    #colour(unit) {
        return BANDS[Math.max(0, this.model.units.indexOf(unit)) % BANDS.length];
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {Robot} robot
     * @param {Palette} palette
     */
    #drawAttachment(on, to, robot, palette) {
        const pose = robot.context?.sensors.pose;
        const unit = robot.context?.attachments.find((attachment) => attachment.attached);
        const at = unit && this.model.nodes.get(unit.radio_unit)?.position;
        if (!pose || !unit || !at) return;
        const [[x1, y1], [x2, y2]] = [to(pose.x, pose.y), to(at.x, at.y)];
        on.strokeStyle = palette.ink;
        on.lineWidth = 1.5;
        on.setLineDash([6, 4]);
        on.beginPath();
        on.moveTo(x1, y1);
        on.lineTo(x2, y2);
        on.stroke();
        on.setLineDash([]);
        if (unit.signal_dbm !== null && unit.signal_dbm !== undefined && Math.hypot(x2 - x1, y2 - y1) > 70) {
            rimmed(on, `${unit.signal_dbm.toFixed(0).replace("-", "−")} dBm`, (x1 + x2) / 2, (y1 + y2) / 2, palette.ink, palette.back);
        }
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {Palette} palette
     */
    #drawUnits(on, to, palette) {
        const used = new Set([...this.model.robots.values()].map((robot) => robot.unit));
        for (const id of this.model.units) {
            const at = this.model.nodes.get(id)?.position;
            if (!at) continue;
            const [x, y] = to(at.x, at.y);
            const colour = this.#colour(id);
            if (used.has(id)) {
                on.strokeStyle = colour;
                on.lineWidth = 2;
                for (const radius of [11, 16]) {
                    for (const middle of [0, Math.PI]) {
                        on.beginPath();
                        on.arc(x, y, radius, middle - 0.7, middle + 0.7);
                        on.stroke();
                    }
                }
            }
            on.fillStyle = colour;
            on.strokeStyle = palette.ink;
            on.lineWidth = 1.2;
            on.beginPath();
            on.rect(x - 6, y - 6, 12, 12);
            on.fill();
            on.stroke();
            on.font = `${used.has(id) ? "bold " : ""}${FONT}`;
            rimmed(on, id, x, y + 16, palette.ink, palette.back);
        }
        on.font = FONT;
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {(x: number, y: number) => [number, number]} to
     * @param {number} scale
     * @param {Robot} robot
     * @param {Palette} palette
     * @param {boolean} focused
     */
    #drawRobot(on, to, scale, robot, palette, focused) {
        const pose = robot.context?.sensors.pose;
        if (!pose) return;
        const [x, y] = to(pose.x, pose.y);
        const { major, minor, angle } = ellipse(pose.covariance);
        on.save();
        on.translate(x, y);
        on.beginPath();
        on.ellipse(0, 0, Math.max(1, major * scale), Math.max(1, minor * scale), -angle, 0, 2 * Math.PI);
        on.fillStyle = faded(palette.series[1], 0.25);
        on.fill();
        on.strokeStyle = faded(palette.series[1], 0.8);
        on.lineWidth = 1;
        on.stroke();
        on.rotate(-pose.heading);
        const size = Math.max(8, Math.min(16, 0.35 * scale));
        on.beginPath();
        on.moveTo(size, 0);
        on.lineTo(-size * 0.75, size * 0.7);
        on.lineTo(-size * 0.4, 0);
        on.lineTo(-size * 0.75, -size * 0.7);
        on.closePath();
        on.fillStyle = (robot.context?.health?.length ?? 0) > 0 ? palette.alert : palette.series[1];
        on.fill();
        on.strokeStyle = focused ? palette.ink : palette.back;
        on.lineWidth = focused ? 2 : 1.5;
        on.stroke();
        on.restore();
        if (this.model.robots.size > 1 || focused) rimmed(on, robot.id, x, y - size - 8, palette.ink, palette.back);
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {number} x
     * @param {number} y
     * @param {Palette} palette
     */
    #drawGoal(on, x, y, palette) {
        on.strokeStyle = palette.alert;
        on.lineWidth = 2;
        on.beginPath();
        on.arc(x, y, 7, 0, 2 * Math.PI);
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
            on.moveTo(x + 3 * dx, y + 3 * dy);
            on.lineTo(x + 12 * dx, y + 12 * dy);
        }
        on.stroke();
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {number} scale
     * @param {Palette} palette
     */
    #drawScale(on, scale, palette) {
        const metres = [0.5, 1, 2, 5, 10, 20, 50, 100].find((length) => length * scale > 50) ?? 200;
        const [x, y] = [12.5, this.canvas.height - 12.5];
        on.strokeStyle = palette.faint;
        on.lineWidth = 1;
        on.beginPath();
        on.moveTo(x, y - 4);
        on.lineTo(x, y);
        on.lineTo(x + metres * scale, y);
        on.lineTo(x + metres * scale, y - 4);
        on.stroke();
        rimmed(on, `${metres} m`, x + (metres * scale) / 2, y - 8, palette.faint, palette.back);
    }

    #tell() {
        const words = [...this.model.robots.values()].slice(0, 10).map((robot) => {
            const pose = robot.context?.sensors.pose;
            return pose ? `${robot.id} at ${pose.x.toFixed(0)}, ${pose.y.toFixed(0)}, ${robot.unit ?? "no radio unit"}` : `${robot.id} not known yet`;
        });
        const { robot: seeing, points } = this.#scan;
        if (points.length > 0) words.push(`the lidar of ${seeing} sees ${points.length} points`);
        if (this.#coverage.of.length > 0) words.push(`coverage of ${this.#coverage.of.map(({ radio_unit }) => radio_unit).join(", ")}`);
        const label = `Map: ${words.join("; ") || "no robots"}`;
        if (this.canvas.base.getAttribute("aria-label") !== label) this.canvas.base.setAttribute("aria-label", label);
    }
}

/**
 * Returns the ellipse of a covariance of x, y and heading.
 * @param {number[]} covariance
 */
export function ellipse(covariance) {
    const [xx, xy, , , yy] = covariance;
    const middle = (xx + yy) / 2;
    const away = Math.hypot((xx - yy) / 2, xy);
    const radius = (/** @type {number} */ variance) => Math.sqrt(Math.max(0, variance) * CHI_SQUARED);
    return { major: radius(middle + away), minor: radius(middle - away), angle: Math.atan2(2 * xy, xx - yy) / 2 };
}

/**
 * Returns what the map shows at first: the free floor, and everything with a place.
 * @param {Model} model
 * @param {Grid | null} grid
 */
export function extent(model, grid) {
    const box = { left: Infinity, right: -Infinity, bottom: Infinity, top: -Infinity };
    const add = (/** @type {number} */ x, /** @type {number} */ y) => {
        [box.left, box.right] = [Math.min(box.left, x), Math.max(box.right, x)];
        [box.bottom, box.top] = [Math.min(box.bottom, y), Math.max(box.top, y)];
    };
    for (const { position } of model.nodes.values()) if (position) add(position.x, position.y);
    for (const { waypoints } of model.testbed.walks) for (const { x, y } of waypoints) add(x, y);
    if (grid) {
        const { origin, resolution_m: cell } = grid.place;
        for (let row = 0; row < grid.height; row++) {
            for (let column = 0; column < grid.width; column++) {
                if (grid.pixels[row * grid.width + column] === UNKNOWN) continue;
                add(origin.x + column * cell, origin.y + (grid.height - row) * cell);
            }
        }
    }
    if (!(box.left < Infinity)) return { left: -5, right: 5, bottom: -5, top: 5 };
    const [x, y] = [Math.max(0, 4 - (box.right - box.left)) / 2, Math.max(0, 4 - (box.top - box.bottom)) / 2];
    return { left: box.left - x, right: box.right + x, bottom: box.bottom - y, top: box.top + y };
}

const UNKNOWN = 205;

/**
 * Begins a drawing, with texts centred.
 * @param {CanvasRenderingContext2D} on
 */
function begin(on) {
    on.font = FONT;
    on.textBaseline = "middle";
    on.textAlign = "center";
}

/**
 * Returns the floor as a picture: walls and free floor in the palette's colours, the rest transparent.
 * @param {Grid} grid
 * @param {Palette} palette
 */
function floor(grid, palette) {
    const picture = element("canvas", { width: grid.width, height: grid.height });
    const on = picture.getContext("2d");
    if (!on) throw new Error("this browser draws nothing on a canvas");
    const image = on.createImageData(grid.width, grid.height);
    const parts = (/** @type {string} */ colour) => parseInt(`ff${colour.slice(5, 7)}${colour.slice(3, 5)}${colour.slice(1, 3)}`, 16);
    const [free, wall] = [parts(palette.floor), parts(palette.wall)];
    const pixels = new Uint32Array(image.data.buffer);
    for (let i = 0; i < pixels.length; i++) {
        const shade = grid.pixels[i];
        pixels[i] = shade === UNKNOWN ? 0 : shade < 128 ? wall : free;
    }
    on.putImageData(image, 0, 0);
    return picture;
}
