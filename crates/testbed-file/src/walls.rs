//! Losses of walls: figures, or the names of materials.

use cotorra_graph::Band;
use serde_json::{Value as Json, json};

use crate::yaml::{
    Decibels, Sink,
    decode::{Decode, Node, choose},
};

/// Loss of a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum WallLoss {
    /// dB.
    Figure(f64),
    Material(Material),
}

/// A wall of one material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Material {
    name: &'static str,
    what: &'static str,
    /// Losses at 2.45 GHz and at 5.5 GHz, dB.
    losses_db: [f64; 2],
}

const NAMES: [&str; 5] = ["glass", "wood", "plasterboard", "brick", "concrete"];

/// Losses at normal incidence: entering the wall, absorption in it, and leaving it, with the permittivity and conductivity
/// of ITU-R P.2040-3, table 3. Reflections within the wall are left out.
const MATERIALS: [Material; 5] = [
    Material { name: NAMES[0], what: "a pane of 6 mm", losses_db: [1.8, 1.9] },
    Material { name: NAMES[1], what: "4 cm, as a door has", losses_db: [0.8, 1.6] },
    Material { name: NAMES[2], what: "two boards of 12.5 mm", losses_db: [1.0, 1.6] },
    Material { name: NAMES[3], what: "12 cm", losses_db: [3.7, 4.1] },
    Material { name: NAMES[4], what: "15 cm", losses_db: [11.4, 20.2] },
];

impl WallLoss {
    /// Returns the loss in a band, dB.
    pub fn db(self, band: Band) -> f64 {
        match (self, band) {
            (Self::Figure(db), _) => db,
            (Self::Material(Material { losses_db: [db, _], .. }), Band::Ghz2) => db,
            (Self::Material(Material { losses_db: [_, db], .. }), Band::Ghz5) => db,
        }
    }
}

impl Decode for WallLoss {
    fn schema() -> Json {
        let described = |m: &Material| {
            let [low, high] = m.losses_db;
            format!("`{}`: {}, {low:.1} dB at 2.4 GHz and {high:.1} dB at 5 GHz", m.name, m.what)
        };
        let mut schema = Decibels::schema();
        let ratio = schema["pattern"].as_str().unwrap_or_default();
        schema["pattern"] = json!(format!("^({})$|{ratio}", NAMES.join("|")));
        schema["examples"] = json!(["3.4 dB", "brick"]);
        schema["description"] = json!(format!("{}.", MATERIALS.each_ref().map(described).join("; ")));
        schema
    }

    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let is_word = |text: &str| text.starts_with(|c: char| c.is_ascii_alphabetic());
        if !node.text().is_some_and(is_word) {
            return Decibels::decode(node, sink).map(|loss| Self::Figure(loss.0));
        }
        let name = choose(node, "material", &NAMES, sink)?;
        MATERIALS.into_iter().find(|material| material.name == name).map(Self::Material)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// Loss of a wall of so many metres at normal incidence, dB. The permittivity is `a`, the conductivity c·f^d in S/m, with
    /// f in GHz (ITU-R P.2040-3).
    fn loss_db([a, c, d, metres]: [f64; 4], ghz: f64) -> f64 {
        // Refractive index n - jk: the root of the complex permittivity a - j·17.98·σ/f.
        let lossy = 17.98 * c * ghz.powf(d) / ghz;
        let modulus = a.hypot(lossy);
        let [n, k] = [modulus + a, modulus - a].map(|part| (part / 2.0).sqrt());
        let absorbed = 2.0 * PI * ghz * 1e9 / 299_792_458.0 * k * metres;
        // Both surfaces together transmit 1 - R² = 4·(n - jk) / (1 + n - jk)².
        let surfaces = 4.0 * n.hypot(k) / ((1.0 + n).powi(2) + k * k);
        -20.0 * (surfaces.log10() - absorbed * std::f64::consts::LOG10_E)
    }

    #[test]
    fn losses_of_materials_follow_the_recommendation() {
        // a, c, d and the thickness.
        let table = [
            ("glass", [6.31, 0.0036, 1.3394, 0.006]),
            ("wood", [1.99, 0.0047, 1.0718, 0.04]),
            ("plasterboard", [2.73, 0.0085, 0.9395, 0.025]),
            ("brick", [3.91, 0.0238, 0.16, 0.12]),
            ("concrete", [5.24, 0.0462, 0.7822, 0.15]),
        ];
        for (material, (name, figures)) in MATERIALS.iter().zip(table) {
            assert_eq!(material.name, name);
            for (loss, ghz) in material.losses_db.into_iter().zip([2.45, 5.5]) {
                let expected = loss_db(figures, ghz);
                assert!((loss - expected).abs() <= 0.05, "{name} at {ghz} GHz: {expected:.2} dB");
            }
        }
    }

    #[test]
    fn materials_are_words_and_figures_have_units() {
        let read = |text: &str| {
            let mut sink = Sink::default();
            WallLoss::decode(&Node::from_json(&json!(text)), &mut sink)
        };
        let brick = read("brick").unwrap();
        assert_eq!([Band::Ghz2, Band::Ghz5].map(|band| brick.db(band)), [3.7, 4.1]);
        assert_eq!(read("3.4 dB").unwrap().db(Band::Ghz5), 3.4);
        for wrong in ["brik", "3.4", "-3 dB", "dB", ""] {
            assert_eq!(read(wrong), None, "{wrong}");
        }
    }
}
