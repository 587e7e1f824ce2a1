// The HTTP API of the run that serves this page: queries, and the stream of events.

/** @typedef {import("#api").components["schemas"]} Schemas */
/** @typedef {Schemas["Stamped"]} Stamped */

/** Longest event that is read. */
const LONGEST = 4 << 20;
const ROOT = "/api/v1/";
const TOKEN_KEY = "cotorra-token";

/** The API wants a token, or another one. */
export class Unauthorized extends Error {}

/** An answer other than 200. */
export class Refused extends Error {
    /**
     * @param {number} status
     * @param {string} reason
     */
    constructor(status, reason) {
        super(reason);
        this.status = status;
    }
}

export class Api {
    /** The token stays in this tab, and leaves with it. */
    #token = sessionStorage.getItem(TOKEN_KEY);

    /** @param {string} token */
    signIn(token) {
        this.#token = token;
        sessionStorage.setItem(TOKEN_KEY, token);
    }

    /** Signs in with the code behind the `#` of the address, if there is one. The code works once. */
    async redeem() {
        const code = location.hash.slice(1);
        if (!code) return;
        history.replaceState(null, "", location.pathname + location.search);
        const call = { method: "POST", path: `${ROOT}sign-in`, body: { code } };
        try {
            this.signIn((await this.send(call)).token);
        } catch (error) {
            // This tab may have used the code already.
            if (!(error instanceof Unauthorized)) throw error;
        }
    }

    /**
     * Gets what is at a path.
     * @template T
     * @param {string} path
     * @param {Record<string, string | number | undefined>} [query]
     * @param {AbortSignal} [signal]
     * @returns {Promise<T>}
     */
    async get(path, query = {}, signal) {
        return (await this.#ask(ROOT + path, query, { signal })).json();
    }

    /**
     * Makes a call, and returns its answer.
     * @template T
     * @param {{ method: string, path: string, body: unknown }} call
     * @returns {Promise<T>}
     */
    async send({ method, path, body }) {
        const headers = { "Content-Type": "application/json" };
        return (await this.#ask(path, {}, { method, headers, body: JSON.stringify(body) })).json();
    }

    /**
     * Gets bytes.
     * @param {string} path
     * @param {AbortSignal} [signal]
     */
    async bytes(path, signal) {
        return new Uint8Array(await (await this.#ask(ROOT + path, {}, { signal })).arrayBuffer());
    }

    /**
     * Reads the stream of events until it ends. `received` gets all events that came at once.
     * @param {string[]} kinds
     * @param {() => void} opened
     * @param {(events: Stamped[], missed: number) => void} received
     * @param {AbortSignal} signal
     */
    async follow(kinds, opened, received, signal) {
        const answer = await this.#ask(`${ROOT}events`, { kinds: kinds.join(",") }, { signal });
        if (!answer.body) throw new Error("the stream has no body");
        opened();
        const parser = new EventParser();
        const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
        for (;;) {
            const { done, value } = await reader.read();
            if (done) return;
            /** @type {Stamped[]} */
            const events = [];
            let missed = 0;
            for (const { name, data } of parser.push(value)) {
                if (name === "missed") missed += Number(data);
                else if (name === "message") events.push(JSON.parse(data));
            }
            if (events.length > 0 || missed > 0) received(events, missed);
        }
    }

    /**
     * @param {string} path
     * @param {Record<string, string | number | undefined>} query
     * @param {RequestInit} options
     */
    async #ask(path, query, options) {
        const words = Object.entries(query).filter(([, value]) => value !== undefined);
        const parameters = new URLSearchParams(words.map(([name, value]) => [name, String(value)])).toString();
        const headers = new Headers(options.headers);
        if (this.#token) headers.set("Authorization", `Bearer ${this.#token}`);
        const url = `${path}${parameters ? `?${parameters}` : ""}`;
        const answer = await fetch(url, { ...options, headers, cache: "no-store", credentials: "omit" });
        if (answer.ok) return answer;
        const body = await answer.json().catch(() => ({}));
        const reason = body.refused ?? body.error ?? `${answer.status} ${answer.statusText}`;
        if (answer.status === 401) throw new Unauthorized(reason);
        throw new Refused(answer.status, reason);
    }
}

/** Splits a stream of server-sent events. */
export class EventParser {
    #rest = "";

    /**
     * Adds text, and returns the events that are whole.
     * @param {string} text
     */
    push(text) {
        const blocks = (this.#rest + text).split("\n\n");
        this.#rest = blocks.pop() ?? "";
        if (this.#rest.length > LONGEST) throw new Error("an event is too long");
        const events = [];
        for (const block of blocks) {
            let name = "message";
            const data = [];
            for (const line of block.split("\n")) {
                if (line.startsWith("data:")) data.push(line.slice(line[5] === " " ? 6 : 5));
                else if (line.startsWith("event:")) name = line.slice(6).trim();
            }
            if (data.length > 0) events.push({ name, data: data.join("\n") });
        }
        return events;
    }
}
