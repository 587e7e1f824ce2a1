//! Packs the picture of the corridor's map, which the program carries for the published experiments: each run of equal bytes
//! becomes that byte and a length of two bytes.

use std::{env, fs, path::Path};

fn main() {
    let variable = |name| env::var_os(name).expect("cargo sets it");
    let root = Path::new(&variable("CARGO_MANIFEST_DIR")).join("../..");
    let picture = root.join("testbeds/maps/corridor.pgm");
    println!("cargo::rerun-if-changed={}", picture.display());
    let picture = fs::read(picture).expect("the checkout has the map");
    let mut packed = Vec::new();
    for run in picture.chunk_by(|one, next| one == next) {
        for part in run.chunks(usize::from(u16::MAX)) {
            packed.push(part[0]);
            packed.extend((part.len() as u16).to_le_bytes());
        }
    }
    fs::write(Path::new(&variable("OUT_DIR")).join("corridor.packed"), packed)
        .expect("cargo made the folder");
}
