// Elements of the page. Texts are set as text, never as markup.

/**
 * Makes an element with attributes and children. An attribute that is `null` or `false` is left out.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, string | number | boolean | null | EventListener>} [attributes]
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
        if (typeof value === "function") made.addEventListener(name, value);
        else if (value !== null && value !== false) made.setAttribute(name, value === true ? "" : String(value));
    }
    made.append(...children);
    return made;
}

/**
 * Returns an element of the page.
 * @template {HTMLElement} [T=HTMLElement]
 * @param {string} id
 * @returns {T}
 */
export function byId(id) {
    const found = document.getElementById(id);
    if (!found) throw new Error(`the page has no #${id}`);
    return /** @type {T} */ (found);
}

/**
 * Sets an element's text if it differs, so that nothing is laid out again.
 * @param {Element} of
 * @param {string} text
 */
export function setText(of, text) {
    if (of.textContent !== text) of.textContent = text;
}

/** Pause between two changes of words, ms: words that change with every frame cannot be read. */
const WORDS_EVERY = 200;

/**
 * Returns a function that calls another one, a little later and once for all calls until then.
 * @param {() => void} tell
 */
export function rarely(tell) {
    let waiting = false;
    return () => {
        if (waiting) return;
        waiting = true;
        setTimeout(() => {
            waiting = false;
            tell();
        }, WORDS_EVERY);
    };
}

/**
 * Saves bytes as a file of the user's.
 * @param {Blob} blob
 * @param {string} name
 */
export function save(blob, name) {
    const url = URL.createObjectURL(blob);
    element("a", { href: url, download: name }).click();
    // The download has begun by then; until it has, the blob must stay.
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
}
