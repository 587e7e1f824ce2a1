// Lines of figures as pixels. A browser without a GPU strokes jagged lines on the page's main thread, which takes most of a
// frame. A figure over time is simpler: in each column of pixels it covers one stretch from top to bottom.

/**
 * @typedef {object} Points Points of a line in pixels, from left to right.
 * @property {Float64Array} xs
 * @property {Float64Array} values Their rows from the top; NaN is a gap.
 * @property {number} length
 */

/** Half the width of a line, in pixels of CSS. */
const HALF = 0.75;

export class Raster {
    /** @type {OffscreenCanvas | null} */
    #canvas = null;
    /** @type {ImageData | null} */
    #image = null;
    #pixels = new Uint32Array(0);
    #tops = new Float32Array(0);
    #bottoms = new Float32Array(0);

    /**
     * Begins with an empty picture.
     * @param {number} width
     * @param {number} height
     */
    begin(width, height) {
        if (this.#image?.width !== width || this.#image.height !== height) {
            this.#canvas = new OffscreenCanvas(width, height);
            this.#image = new ImageData(width, height);
            this.#pixels = new Uint32Array(this.#image.data.buffer);
            [this.#tops, this.#bottoms] = [new Float32Array(width), new Float32Array(width)];
        } else this.#pixels.fill(0);
    }

    /**
     * Draws a line.
     * @param {Points} points
     * @param {string} colour As `#rrggbb`.
     * @param {number[]} dash Lengths of dashes and gaps in pixels.
     * @param {number} density
     */
    line(points, colour, dash, density) {
        const image = this.#image;
        if (!image) return;
        const [tops, bottoms] = [this.#tops, this.#bottoms];
        spans(points, tops, bottoms);
        const { width, height } = image;
        const pixels = this.#pixels;
        const number = parseInt(colour.slice(1), 16);
        const rgb = ((number & 0xff) << 16) | (number & 0xff00) | (number >> 16);
        const half = HALF * density;
        const cycle = dash.reduce((sum, length) => sum + length, 0) * density;
        for (let x = 0; x < width; x++) {
            if (tops[x] > bottoms[x] || (cycle > 0 && !isDash(x % cycle, dash, density))) continue;
            const [top, bottom] = [Math.max(0, tops[x] - half), Math.min(height, bottoms[x] + half)];
            for (let y = Math.floor(top); y < bottom; y++) {
                const covered = Math.min(y + 1, bottom) - Math.max(y, top);
                const at = y * width + x;
                // The later line is in front.
                if (pixels[at] === 0) pixels[at] = rgb | (Math.round(covered * 255) << 24);
                else if (covered > 0.5) pixels[at] = rgb | (255 << 24);
            }
        }
    }

    /**
     * Copies the picture to a canvas.
     * @param {CanvasRenderingContext2D} on
     * @param {number} x
     * @param {number} y
     * @param {number} width
     * @param {number} height
     */
    copy(on, x, y, width, height) {
        if (!this.#canvas || !this.#image) return;
        this.#canvas.getContext("2d")?.putImageData(this.#image, 0, 0);
        on.drawImage(this.#canvas, x, y, width, height);
    }
}

/**
 * @param {number} at
 * @param {number[]} dash
 * @param {number} density
 */
function isDash(at, dash, density) {
    let place = at;
    for (let i = 0; i < dash.length; i++) {
        place -= dash[i] * density;
        if (place < 0) return i % 2 === 0;
    }
    return true;
}

/**
 * Finds what a line covers in each column: from `tops` to `bottoms`, or nothing where the top is below the bottom.
 * @param {Points} points
 * @param {Float32Array} tops
 * @param {Float32Array} bottoms
 */
export function spans({ xs, values, length }, tops, bottoms) {
    tops.fill(Infinity);
    bottoms.fill(-Infinity);
    const width = tops.length;
    let [beforeX, beforeY] = [NaN, NaN];
    for (let i = 0; i < length; i++) {
        const [x, y] = [xs[i], values[i]];
        const column = Math.floor(x);
        if (!Number.isNaN(beforeY) && !Number.isNaN(y)) {
            // At a crossing from a column to the next, both have the place.
            const slope = (y - beforeY) / (x - beforeX);
            for (let edge = Math.max(0, Math.floor(beforeX) + 1); edge <= Math.min(column, width); edge++) {
                const at = beforeY + slope * (edge - beforeX);
                cover(tops, bottoms, edge - 1, at);
                cover(tops, bottoms, edge, at);
            }
        }
        if (!Number.isNaN(y)) cover(tops, bottoms, column, y);
        [beforeX, beforeY] = [x, y];
    }
}

/**
 * @param {Float32Array} tops
 * @param {Float32Array} bottoms
 * @param {number} column
 * @param {number} y
 */
function cover(tops, bottoms, column, y) {
    if (column < 0 || column >= tops.length) return;
    if (y < tops[column]) tops[column] = y;
    if (y > bottoms[column]) bottoms[column] = y;
}
