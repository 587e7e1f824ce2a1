//! Places at which robots roamed by themselves.

use cotorra_graph::NodeId;
use cotorra_testbed::DataTable;
use serde::Serialize;

use super::{Kind, NOT_MEASURED, Walk, Walked, figures::kinds};

/// A handover that a robot decided on by itself, on the walks of all kinds with one seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Place {
    pub seed: u64,
    pub from: NodeId,
    pub to: NodeId,
    /// Distance that the robot had walked on each kind of radio, metres along its way; `None` where it did not roam so.
    pub walked_m: Vec<(&'static str, Option<f64>)>,
}

/// Matches handovers of all kinds: the first from one radio unit to another with the first, and so on.
pub(super) fn places(walks: &[Walked]) -> Vec<Place> {
    let kinds: Vec<_> = kinds(walks).collect();
    let mut places: Vec<Place> = Vec::new();
    for walked in walks.iter().filter(|walked| walked.walk == Walk::Alone) {
        let Some(column) = kinds.iter().position(|kind| *kind == walked.kind) else { continue };
        for roam in &walked.roams {
            let free = places.iter_mut().find(|place| {
                (place.seed, &place.from, &place.to) == (walked.seed, &roam.from, &roam.to)
                    && place.walked_m[column].1.is_none()
            });
            match free {
                Some(place) => place.walked_m[column].1 = roam.walked_m,
                None => {
                    let mut walked_m: Vec<_> = kinds.iter().map(|kind| (*kind, None)).collect();
                    walked_m[column].1 = roam.walked_m;
                    let (from, to) = (roam.from.clone(), roam.to.clone());
                    places.push(Place { seed: walked.seed, from, to, walked_m });
                }
            }
        }
    }
    let earliest =
        |place: &Place| place.walked_m.iter().filter_map(|(_, walked)| *walked).fold(f64::INFINITY, f64::min);
    places.sort_by(|a, b| (a.seed.cmp(&b.seed)).then(earliest(a).total_cmp(&earliest(b))));
    places
}

pub(super) fn table(places: &[Place]) -> DataTable {
    let kinds: Vec<_> = places
        .first()
        .map(|place| place.walked_m.iter().map(|(kind, _)| *kind).collect())
        .unwrap_or_default();
    let heads = ["roamed by itself", "seed"].map(str::to_owned).into_iter();
    let mut table = DataTable::new(heads.chain(kinds.iter().map(|kind| format!("{kind}, m")))).right_after(1);
    for place in places {
        let walked = place.walked_m.iter().map(|(kind, walked)| match walked {
            Some(walked) => format!("{walked:.1}"),
            None if Kind::named(kind).is_some_and(|kind| !kind.is_emulated) => NOT_MEASURED.to_owned(),
            None => "–".to_owned(),
        });
        let names = [format!("{} to {}", place.from, place.to), place.seed.to_string()];
        table.row(names.into_iter().chain(walked));
    }
    table
}
