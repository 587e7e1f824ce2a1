// Figures as text.

/**
 * Formats seconds since the run began, as in 1:05 or 1:02:05.
 * @param {number} seconds
 * @param {number} [decimals]
 */
export function clock(seconds, decimals = 0) {
    if (!Number.isFinite(seconds)) return "–:––";
    const scale = 10 ** decimals;
    const units = Math.round(Math.abs(seconds) * scale);
    const whole = Math.floor(units / scale);
    const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
    const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
    const rest = two(whole % 60) + (decimals ? "." + String(units % scale).padStart(decimals, "0") : "");
    return (seconds < 0 ? "−" : "") + (hours ? `${hours}:${two(minutes)}:${rest}` : `${minutes}:${rest}`);
}

/**
 * Formats a figure with about three digits.
 * @param {number | null | undefined} value
 * @param {string} [unit]
 */
export function figure(value, unit = "") {
    if (value === null || value === undefined || !Number.isFinite(value)) return "–";
    if (unit === "bit/s" || unit === "bytes") return prefixed(value, unit === "bytes" ? "B" : unit);
    const size = Math.abs(value);
    const decimals = size >= 100 || size === 0 ? 0 : size >= 10 ? 1 : 2;
    const text = value.toFixed(decimals).replace("-", "−");
    return unit ? `${text} ${unit}` : text;
}

/**
 * Formats a large figure with a prefix, as in 6.2 Mbit/s.
 * @param {number} value
 * @param {string} unit
 */
function prefixed(value, unit) {
    const prefixes = ["", "k", "M", "G", "T"];
    let [size, at] = [Math.abs(value), 0];
    while (size >= 999.5 && at < prefixes.length - 1) [size, at] = [size / 1000, at + 1];
    const decimals = size >= 100 || at === 0 ? 0 : size >= 10 ? 1 : 2;
    return `${value < 0 ? "−" : ""}${size.toFixed(decimals)} ${prefixes[at]}${unit}`;
}

/**
 * Formats a share, as in 25.5 %.
 * @param {number} share
 */
export function percent(share) {
    return Number.isFinite(share) ? `${(share * 100).toFixed(1)} %` : "–";
}

/**
 * Returns round places on an axis, about `count` of them, and the distance between two.
 * @param {number} low
 * @param {number} high
 * @param {number} count
 */
export function ticks(low, high, count) {
    const rough = (high - low) / Math.max(1, count);
    if (!(rough > 0) || !Number.isFinite(rough)) return { step: 1, places: [low] };
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * (rough / power <= 1 ? 1 : rough / power <= 2 ? 2 : rough / power <= 5 ? 5 : 10);
    return { step, places: places(low, high, step) };
}

const TIME_STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];

/**
 * Returns round times on an axis, `count` of them at most, and the distance between two.
 * @param {number} from
 * @param {number} until
 * @param {number} count
 */
export function timeTicks(from, until, count) {
    const rough = (until - from) / Math.max(1, count);
    const step = TIME_STEPS.find((step) => step >= rough) ?? Math.ceil(rough / 86400) * 86400;
    return { step, places: places(from, until, step) };
}

/**
 * @param {number} low
 * @param {number} high
 * @param {number} step
 */
function places(low, high, step) {
    const first = Math.ceil(low / step - 1e-9);
    const last = Math.floor(high / step + 1e-9);
    return Array.from({ length: Math.max(0, Math.min(last - first + 1, 1000)) }, (_, i) => (first + i) * step);
}
