//! Where a scan could have been taken, asked of the whole map: for a robot that does not know where it is, and for one
//! that was carried away. Uniform particles would need luck, because the likelihood is sharp: the best of many are
//! moved uphill before they become particles (sensor resetting; Lenser and Veloso 2000).

use crate::{
    field::LikelihoodField,
    place::{Place, Places},
    random::Stream,
    scan::Beams,
    weights,
};

/// Directions in which each cell is looked at.
const HEADINGS: usize = 72;
/// So many places about one are looked at, and how far they are from it: deviations, metres and radians.
const MOST_NEAR: usize = 4000;
const NEAR: [f32; 2] = [0.4, 0.3];
/// So many of the best are moved uphill.
const KEPT: usize = 1000;
const KEPT_NEAR: usize = 400;
/// Steps uphill, and the deviation of the first, metres and radians; each next one is a little shorter.
const STEPS: usize = 40;
const FIRST_STEP: [f32; 2] = [0.15, 0.1];
const SHORTER: f32 = 0.95;

/// Places from which a scan would have looked like that, each with its share.
#[derive(Debug, Clone, Default)]
pub(crate) struct Candidates {
    places: Places,
    cumulative: Vec<f64>,
}

impl Candidates {
    /// Looks for them on all of the map; `None` if there is none.
    pub fn find(field: &LikelihoodField, beams: &Beams, random: &mut Stream) -> Option<Self> {
        let found = field.search(beams, HEADINGS, KEPT);
        (found.len() > 0).then(|| Self::uphill(found, field, beams, random))
    }

    /// Looks for them about a place, to which odometry has led, but badly.
    pub fn near(place: Place, field: &LikelihoodField, beams: &Beams, random: &mut Stream) -> Self {
        let [way, turn] = [NEAR[0] / field.resolution() as f32, NEAR[1]];
        let mut off = |deviation: f32| deviation * random.bell();
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

    /// Moves each of these places to where the scan fits better.
    fn uphill(places: Places, field: &LikelihoodField, beams: &Beams, random: &mut Stream) -> Self {
        let kept = places.len();
        let mut best: Vec<(f32, Place)> = (0..kept).map(|nth| (f32::NEG_INFINITY, places.at(nth))).collect();
        let in_cells = (FIRST_STEP[0] as f64 / field.resolution()) as f32;
        let (mut steps, mut length, mut scores) = (Places::default(), 0.0, Vec::new());
        for step in 0..STEPS {
            steps.clear();
            for (_, place) in &best {
                steps.push(Place {
                    column: place.column + in_cells * length * random.bell(),
                    row: place.row + in_cells * length * random.bell(),
                    heading: place.heading + FIRST_STEP[1] * length * random.bell(),
                });
            }
            field.score(&steps, beams, &mut scores);
            for (nth, best) in best.iter_mut().enumerate().filter(|(nth, best)| scores[*nth] > best.0) {
                *best = (scores[nth], steps.at(nth));
            }
            // The first is none, but tells how well each place fits.
            length = if step == 0 { 1.0 } else { length * SHORTER };
        }
        // How likely one is beside another is not trusted far: one scan says little of which corridor it was.
        let scores: Vec<f32> = best.iter().map(|(score, _)| *score).collect();
        let alike = vec![(kept as f32).recip(); kept];
        let share = weights::tempered(&alike, &scores, kept as f64 / 8.0);
        let mut weight = alike;
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

    /// All of them.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Draws one.
    pub fn draw(&self, random: &mut Stream) -> Place {
        let share = random.uniform() * self.cumulative.last().copied().unwrap_or(1.0);
        let nth = self.cumulative.partition_point(|&reached| reached <= share);
        self.places.at(nth.min(self.places.len() - 1))
    }
}
