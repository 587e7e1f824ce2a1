//! Search for places where a scan could have been taken: for a robot with an unknown start, and for one that was carried
//! away.
//!
//! The likelihood is too sharp for uniform particles. The best of many places are moved uphill before they become particles
//! (sensor resetting; Lenser and Veloso 2000).

use cotorra_numbers::Draws;

use crate::{
    field::LikelihoodField,
    place::{Place, Places},
    scan::Beams,
    weights,
};

/// Headings that are tried in each cell.
const HEADINGS: usize = 72;
/// Places that are tried near an expected one, and their standard deviations from it, metres and radians.
const MOST_NEAR: usize = 4000;
const NEAR: [f32; 2] = [0.4, 0.3];
/// Number of best places that are moved uphill.
const KEPT: usize = 1000;
const KEPT_NEAR: usize = 400;
/// Steps uphill, the standard deviation of the first, metres and radians, and the factor from each step to the next.
const STEPS: usize = 40;
const FIRST_STEP: [f32; 2] = [0.15, 0.1];
const SHORTER: f32 = 0.95;

/// Places where a scan could have been taken, with their cumulative weights.
#[derive(Debug, Clone, Default)]
pub(crate) struct Candidates {
    places: Places,
    cumulative: Vec<f64>,
}

impl Candidates {
    /// Searches the whole map; `None` if nothing fits.
    pub fn find(field: &LikelihoodField, beams: &Beams, random: &mut Draws) -> Option<Self> {
        let found = field.search(beams, HEADINGS, KEPT);
        (found.len() > 0).then(|| Self::uphill(found, field, beams, random))
    }

    /// Searches near a place that odometry led to.
    pub fn near(place: Place, field: &LikelihoodField, beams: &Beams, random: &mut Draws) -> Self {
        let [way, turn] = [NEAR[0] / field.resolution() as f32, NEAR[1]];
        let mut off = |deviation: f32| deviation * random.bell_f32();
        let mut pool = Places::default();
        for _ in 0..MOST_NEAR {
            pool.push(Place {
                column: place.column + off(way),
                row: place.row + off(way),
                heading: place.heading + off(turn),
            });
        }
        let mut scores = Vec::new();
        field.score(&pool, beams, &mut scores);
        let mut order: Vec<usize> = (0..pool.len()).collect();
        order.select_nth_unstable_by(KEPT_NEAR - 1, |&a, &b| scores[b].total_cmp(&scores[a]));
        let mut best = Places::default();
        order[..KEPT_NEAR].iter().for_each(|&nth| best.push(pool.at(nth)));
        Self::uphill(best, field, beams, random)
    }

    /// Moves each place to where the scan fits better.
    fn uphill(places: Places, field: &LikelihoodField, beams: &Beams, random: &mut Draws) -> Self {
        let kept = places.len();
        let mut best: Vec<(f32, Place)> = (0..kept).map(|nth| (f32::NEG_INFINITY, places.at(nth))).collect();
        let in_cells = (FIRST_STEP[0] as f64 / field.resolution()) as f32;
        let (mut steps, mut length, mut scores) = (Places::default(), 0.0, Vec::new());
        for step in 0..STEPS {
            steps.clear();
            for (_, place) in &best {
                steps.push(Place {
                    column: place.column + in_cells * length * random.bell_f32(),
                    row: place.row + in_cells * length * random.bell_f32(),
                    heading: place.heading + FIRST_STEP[1] * length * random.bell_f32(),
                });
            }
            field.score(&steps, beams, &mut scores);
            for (nth, best) in best.iter_mut().enumerate().filter(|(nth, best)| scores[*nth] > best.0) {
                *best = (scores[nth], steps.at(nth));
            }
            // The first step has length 0: it only scores the places.
            length = if step == 0 { 1.0 } else { length * SHORTER };
        }
        // Differences between places are tempered: one scan hardly distinguishes corridors.
        let scores: Vec<f32> = best.iter().map(|(score, _)| *score).collect();
        let mut weight = vec![(kept as f32).recip(); kept];
        let share = weights::tempered(&weight, &scores, kept as f64 / 8.0);
        weights::multiply(&mut weight, &scores, share);
        let mut sum = 0.0;
        let cumulative = weight
            .iter()
            .map(|&weight| {
                sum += f64::from(weight);
                sum
            })
            .collect();
        let mut places = Places::default();
        best.into_iter().for_each(|(_, place)| places.push(place));
        Self { places, cumulative }
    }

    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Draws a place by its weight.
    pub fn draw(&self, random: &mut Draws) -> Place {
        let share = random.unit() * self.cumulative.last().copied().unwrap_or(1.0);
        let nth = self.cumulative.partition_point(|&reached| reached <= share);
        self.places.at(nth.min(self.places.len() - 1))
    }
}
