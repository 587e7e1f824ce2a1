// Greyscale pictures (PGM, binary).

/**
 * Reads a picture with a byte for each pixel.
 * @param {Uint8Array} file
 */
export function read(file) {
    let at = 0;
    const word = () => {
        while (file[at] <= 32) at += 1;
        const begin = at;
        while (at < file.length && file[at] > 32) at += 1;
        return String.fromCharCode(...file.subarray(begin, at));
    };
    const [kind, width, height, most] = [word(), Number(word()), Number(word()), Number(word())];
    const pixels = file.subarray(at + 1);
    if (kind !== "P5" || most !== 255 || pixels.length !== width * height) throw new Error("the map is no picture");
    return { width, height, pixels };
}
