//! A hypothesis: particles about places where a robot may be, and what is needed to carry them on.

use std::sync::Arc;

use crate::{
    belief::cholesky,
    bins::Binning,
    cluster::Cluster,
    doubt::Odds,
    field::LikelihoodField,
    motion::Motion,
    parameters::{Parameters, Weighing},
    particles::Particles,
    place::{Place, Places},
    random::Stream,
    relocate::Candidates,
    scan::Beams,
    weights,
};

/// Of the particles, no more than this share are lost to one step of weighing: a sharp likelihood is taken in steps.
const LEAST_EFFECTIVE: f64 = 0.05;
/// So many steps at most.
const STEPS: usize = 5;
/// Deviation of particles about a candidate, metres and radians.
const ABOUT_CANDIDATE: [f64; 2] = [0.05, 0.02];

/// What all hypotheses share: the map, the scan, and room to compute in.
#[derive(Debug, Clone)]
pub(crate) struct Bench {
    pub field: Arc<LikelihoodField>,
    pub parameters: Parameters,
    pub random: Stream,
    pub beams: Beams,
    pub scores: Vec<f32>,
    binning: Binning,
    /// What the last drawing left over: room for the next.
    spare: Particles,
}

impl Bench {
    pub fn new(field: Arc<LikelihoodField>, parameters: Parameters, seed: u64) -> Self {
        Self {
            binning: Binning::new(field.resolution()),
            random: Stream::new(seed),
            beams: Beams::default(),
            scores: Vec::new(),
            spare: Particles::default(),
            field,
            parameters,
        }
    }

    pub fn weighs_by_likelihood(&self) -> bool {
        matches!(self.parameters.weighing, Weighing::Likelihood { .. })
    }

    /// The best score of the scan at these places.
    pub fn best(&mut self, places: &Places) -> f64 {
        self.score(places);
        best(&self.scores).into()
    }

    /// Which share of the votes is at walls, for a score.
    pub fn hit_share(&self, score: f64) -> f64 {
        self.field.hit_share(score as f32, self.beams.votes)
    }

    fn score(&mut self, places: &Places) {
        self.field.score(places, &self.beams, &mut self.scores);
    }
}

/// Particles, of which the heaviest cluster is the pose.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    pub particles: Particles,
    /// As of the last update.
    pub cluster: Cluster,
    /// That the robot is there.
    pub odds: Odds,
    /// How well the last scan fits there, beside what is usual.
    pub fit: f64,
}

impl Track {
    /// Particles that are at these places, all alike.
    pub fn new(places: impl Iterator<Item = Place>, odds: Odds, bench: &Bench) -> Self {
        let mut particles = Particles::default();
        places.for_each(|place| particles.push(place, 1.0));
        particles.normalize();
        Self { cluster: Cluster::heaviest(&particles, &bench.binning), particles, odds, fit: 1.0 }
    }

    /// So many particles about places that fit the scan.
    pub fn about(candidates: &Candidates, count: usize, odds: Odds, bench: &mut Bench) -> Self {
        let [way, turn] = [ABOUT_CANDIDATE[0] / bench.field.resolution(), ABOUT_CANDIDATE[1]];
        let random = &mut bench.random;
        let places: Vec<Place> =
            (0..count).map(|_| candidates.draw(random).moved(way as f32, turn as f32, random)).collect();
        Self::new(places.into_iter(), odds, bench)
    }

    /// Goes a step of odometry.
    pub fn go(&mut self, motion: &Motion, bench: &mut Bench) {
        motion.sample(&mut self.particles.places, bench.field.resolution(), &mut bench.random);
    }

    /// Normalizes the weights, and finds the heaviest hypothesis.
    pub fn settle(&mut self, bench: &Bench) {
        self.particles.normalize();
        self.cluster = Cluster::heaviest(&self.particles, &bench.binning);
    }

    /// Weighs the particles by the scan. Returns its evidence, and the score where it fits best.
    pub fn weigh(&mut self, bench: &mut Bench) -> [f64; 2] {
        bench.score(&self.particles.places);
        if !bench.weighs_by_likelihood() {
            let weights = self.particles.weight.iter_mut().zip(&bench.scores);
            weights.for_each(|(weight, score)| *weight *= 1.0 + score);
            return [0.0; 2];
        }
        let mut evidence = 0.0;
        let mut rest = 1.0;
        for _ in 1..STEPS {
            let least = LEAST_EFFECTIVE * self.particles.len() as f64;
            let share = weights::tempered(&self.particles.weight, &bench.scores, least);
            if share == 1.0 {
                break;
            }
            evidence += weights::multiply(&mut self.particles.weight, &bench.scores, share);
            rest *= 1.0 - share;
            self.settle(bench);
            self.spread(bench);
            bench.score(&self.particles.places);
            bench.scores.iter_mut().for_each(|score| *score *= rest);
        }
        evidence += weights::multiply(&mut self.particles.weight, &bench.scores, 1.0);
        [evidence, f64::from(best(&bench.scores) / rest)]
    }

    /// Adds particles, which have that probability together.
    pub fn add(&mut self, added: &Self, probability: f64) {
        self.particles.normalize();
        self.particles.weight.iter_mut().for_each(|weight| *weight *= (1.0 - probability) as f32);
        let weight = (probability / added.particles.len() as f64) as f32;
        for nth in 0..added.particles.len() {
            self.particles.push(added.particles.places.at(nth), weight);
        }
    }

    /// Draws particles anew: as many as KLD-sampling asks for.
    pub fn draw(&mut self, bench: &mut Bench) {
        let parameters = bench.parameters;
        self.draw_with(&parameters, bench);
    }

    fn draw_with(&mut self, parameters: &Parameters, bench: &mut Bench) {
        self.particles.draw(&mut bench.spare, parameters, &bench.binning, &mut bench.random);
        std::mem::swap(&mut self.particles, &mut bench.spare);
    }

    /// Draws as many particles as there are, each a little off its parent: the kernel of a regularized filter (Musso,
    /// Oudjane and Le Gland 2001, section 12.2.2), shaped as the heaviest hypothesis.
    fn spread(&mut self, bench: &mut Bench) {
        let count = self.particles.len();
        self.draw_with(&Parameters { min_particles: count, max_particles: count, ..bench.parameters }, bench);
        // Silverman's bandwidth in three dimensions, (4 / 5n)^(1/7).
        let bandwidth = (0.8 / count as f64).powf(1.0 / 7.0);
        let kernel = self.cluster.covariance.map(|entry| entry * bandwidth * bandwidth);
        self.jitter(&cholesky(&kernel), bench);
    }

    /// Moves each particle by a normal deviate, given the lower root of its covariance, in cells.
    pub fn jitter(&mut self, root: &[f64; 9], bench: &mut Bench) {
        let root = root.map(|entry| entry as f32);
        let Places { column, row, heading } = &mut self.particles.places;
        for ((column, row), heading) in column.iter_mut().zip(row).zip(heading) {
            let [a, b, c] = [(); 3].map(|()| bench.random.bell());
            *column += root[0] * a;
            *row += root[3] * a + root[4] * b;
            *heading += root[6] * a + root[7] * b + root[8] * c;
        }
    }

    /// Where it most likely is.
    pub fn place(&self) -> Place {
        let Cluster { column, row, heading, .. } = self.cluster;
        Place { column: column as f32, row: row as f32, heading: heading as f32 }
    }
}

fn best(scores: &[f32]) -> f32 {
    scores.iter().copied().fold(f32::NEG_INFINITY, f32::max)
}
