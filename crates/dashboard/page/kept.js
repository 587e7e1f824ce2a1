// Verdicts on services whose testbed file demands a share of samples within the target.

/** @typedef {import("#api").components["schemas"]} Schemas */

/** The 97.5th percentile of the normal distribution. */
const Z = 1.959963984540054;

/**
 * Describes the share of samples within the target, of so many, and the verdict on it if a share is demanded.
 * @param {{ within: number, samples: number }} counts
 * @param {number | null | undefined} keep The demanded share.
 */
export function kept({ within, samples }, keep) {
    const share = `${told(within / samples, keep ?? within / samples)} of ${samples} in time`;
    if (keep === null || keep === undefined) return share;
    const [low, high] = wilson(within, samples);
    const sure = keep < low || keep > high ? "" : ", too few to be sure";
    return `${share}: ${within / samples >= keep ? "PASS" : "FAIL"} (${figure(keep)} demanded${sure})`;
}

/**
 * Describes the KPIs of services beside their targets: as a recorded run judged them, or else as the testbed file has them.
 * @param {Pick<Schemas["Service"], "id" | "kpis">[]} services
 * @param {Schemas["ServiceKpis"][]} recorded
 */
export function judged(services, recorded) {
    const all = recorded.flatMap(({ service, kpis }) => (kpis ?? []).map((kpi) => ({ service, ...kpi })));
    if (all.length === 0) {
        return { verdict: null, sentences: services.flatMap(({ id, kpis }) => (kpis.require ?? []).map((bound) => `${id}: ${bound}.`)) };
    }
    const verdicts = all.flatMap(({ verdict }) => verdict ?? []);
    const sentences = all.map(({ service, kpi, verdict, measured, reason }) =>
        `${service}: ${kpi}: ${[verdict ?? "not judged", measured ?? reason ?? "not measured"].join(", ")}.`);
    return { verdict: verdicts.includes("FAIL") ? "FAIL" : (verdicts[0] ?? null), sentences };
}

/**
 * Returns the 95 % interval of a share, by Wilson (1927).
 * @param {number} within
 * @param {number} samples
 */
export function wilson(within, samples) {
    const share = within / samples;
    const middle = share + (Z * Z) / (2 * samples);
    const half = Z * Math.sqrt((share * (1 - share)) / samples + (Z * Z) / (4 * samples * samples));
    const scale = 1 + (Z * Z) / samples;
    return [within === 0 ? 0 : (middle - half) / scale, within === samples ? 1 : (middle + half) / scale];
}

/**
 * Formats a share so that it does not look like all, none, or another one.
 * @param {number} share
 * @param {number} other
 */
function told(share, other) {
    const text = (/** @type {number} */ of, /** @type {number} */ digits) => (of * 100).toFixed(digits);
    let digits = 1;
    while (digits < 6 && share !== other && text(share, digits) === text(other, digits)) digits++;
    const shown = digits > 1 || share <= 0 || share >= 1 ? share : Math.min(0.999, Math.max(0.001, share));
    return `${text(shown, digits)} %`;
}

/** @param {number} share */
function figure(share) {
    return `${Math.round(share * 1e8) / 1e6} %`;
}
