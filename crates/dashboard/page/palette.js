// The colours of all figures of cotorra: those of Okabe and Ito, which colour-blind readers can distinguish. On a dark page
// the dark ones are lighter.

const BLUE = "#0072b2";
const VERMILLION = "#d55e00";
const GREEN = "#009e73";
const PURPLE = "#cc79a7";
const ORANGE = "#e69f00";
const SKY = "#56b4e9";
const YELLOW = "#f0e442";
const GREY = "#999999";

/** Of radio units, in the testbed's order, on the map and in the charts. */
export const BANDS = [SKY, ORANGE, GREEN, PURPLE, YELLOW, VERMILLION, BLUE];

/** @typedef {ReturnType<typeof palette>} Palette */

/**
 * Returns the colours of a light or a dark page.
 * @param {boolean} dark
 */
export function palette(dark) {
    const lit = (/** @type {string} */ colour, /** @type {number} */ share) => (dark ? mix(colour, "#ffffff", share) : colour);
    return {
        dark,
        /** Of series, in order. */
        series: [
            lit(BLUE, 0.3), lit(VERMILLION, 0.12), lit(GREEN, 0.12), PURPLE, dark ? "#d7dbe2" : "#000000", SKY, ORANGE, GREY,
        ],
        /** Of regions by radio unit. */
        bands: BANDS,
        alert: dark ? "#ff6b7d" : "#b01030",
        back: dark ? "#14171c" : "#ffffff",
        ink: dark ? "#e4e7ec" : "#1b1f24",
        faint: dark ? "#9aa3af" : "#5b6470",
        grid: dark ? "#262b33" : "#e8ebef",
        axis: dark ? "#454d59" : "#b9c0c9",
        floor: dark ? "#20252d" : "#f4f6f8",
        wall: dark ? "#7d8794" : "#48515c",
    };
}

/** Dashes of series, in order, so that lines differ without colours, too. */
export const DASHES = [[], [6, 3], [2, 2.5], [8, 2.5, 2, 2.5], [12, 4], [4, 2], [8, 2, 2, 2, 2, 2], [2, 5]];

/**
 * Returns a colour with another opacity.
 * @param {string} colour
 * @param {number} opacity
 */
export function faded(colour, opacity) {
    const byte = Math.round(opacity * 255).toString(16).padStart(2, "0");
    return colour + byte;
}

/**
 * @param {string} one
 * @param {string} other
 * @param {number} share Of the other.
 */
function mix(one, other, share) {
    const parts = (/** @type {string} */ c) => [1, 3, 5].map((at) => parseInt(c.slice(at, at + 2), 16));
    const others = parts(other);
    return "#" + parts(one).map((part, i) => Math.round(part + (others[i] - part) * share).toString(16).padStart(2, "0")).join("");
}
