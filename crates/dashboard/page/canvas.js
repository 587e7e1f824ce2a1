// A canvas that fills its element, sharp on every screen, and a layer above it for what follows the pointer.

import { element } from "./dom.js";

/** Pixels of a screen that are used for one of CSS, at most. */
const DENSEST = 2;

export class Canvas {
    /**
     * @param {HTMLElement} host
     * @param {string} label
     * @param {() => void} resized
     */
    constructor(host, label, resized) {
        this.host = host;
        this.base = element("canvas", { role: "img", "aria-label": label, tabindex: 0 });
        this.over = element("canvas", { "aria-hidden": "true", class: "over" });
        host.append(this.base, this.over);
        this.width = 0;
        this.height = 0;
        this.density = 1;
        new ResizeObserver(() => {
            this.#fit();
            resized();
        }).observe(host);
        this.#fit();
    }

    #fit() {
        const { clientWidth, clientHeight } = this.host;
        this.density = Math.min(DENSEST, window.devicePixelRatio || 1);
        [this.width, this.height] = [clientWidth, clientHeight];
        for (const canvas of [this.base, this.over]) {
            canvas.width = Math.max(1, Math.round(clientWidth * this.density));
            canvas.height = Math.max(1, Math.round(clientHeight * this.density));
        }
    }

    /**
     * Clears a layer, and returns its context in pixels of CSS.
     * @param {HTMLCanvasElement} layer
     */
    clear(layer) {
        const context = layer.getContext("2d");
        if (!context) throw new Error("this browser draws nothing on a canvas");
        context.setTransform(this.density, 0, 0, this.density, 0, 0);
        context.clearRect(0, 0, this.width, this.height);
        return context;
    }
}

/**
 * Draws text with a rim in another colour, so that it can be read on anything.
 * @param {CanvasRenderingContext2D} context
 * @param {string} text
 * @param {number} x
 * @param {number} y
 * @param {string} colour
 * @param {string} rim
 */
export function rimmed(context, text, x, y, colour, rim) {
    context.lineJoin = "round";
    context.lineWidth = 3;
    context.strokeStyle = rim;
    context.strokeText(text, x, y);
    context.fillStyle = colour;
    context.fillText(text, x, y);
}

export const FONT = "11px system-ui, sans-serif";
