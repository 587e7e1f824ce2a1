//! A hypothesis of a robot's place: particles with the odds that the robot is among them.

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
    relocate::Candidates,
    scan::Beams,
    weights,
};
use cotorra_numbers::Draws;

/// Smallest effective share of the particles after one step of weighing. Sharper likelihoods are applied in several steps.
const LEAST_EFFECTIVE: f64 = 0.05;
/// Largest number of these steps.
const STEPS: usize = 5;
/// Standard deviation of particles about a candidate, metres and radians.
const ABOUT_CANDIDATE: [f64; 2] = [0.05, 0.02];

/// State that all hypotheses share: the map, the scan and buffers.
#[derive(Debug, Clone)]
pub(crate) struct Bench {
    pub field: Arc<LikelihoodField>,
    pub parameters: Parameters,
    pub random: Draws,
    pub beams: Beams,
    pub scores: Vec<f32>,
    binning: Binning,
    /// Buffer for resampling.
    spare: Particles,
}

impl Bench {
    pub fn new(field: Arc<LikelihoodField>, parameters: Parameters, seed: u64) -> Self {
        Self {
            binning: Binning::new(field.resolution()),
            random: Draws::new(seed, "localization"),
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

    /// Returns the best score of the scan at these places.
    pub fn best(&mut self, places: &Places) -> f64 {
        self.score(places);
        best(&self.scores).into()
    }

    /// Returns the share of the votes at walls for a score.
    pub fn hit_share(&self, score: f64) -> f64 {
        self.field.hit_share(score as f32, self.beams.votes)
    }

    fn score(&mut self, places: &Places) {
        self.field.score(places, &self.beams, &mut self.scores);
    }
}

/// A hypothesis. The heaviest cluster of its particles is the pose.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    pub particles: Particles,
    /// The heaviest cluster as of the last update.
    pub cluster: Cluster,
    /// Odds that the robot is there.
    pub odds: Odds,
    /// Fit of the last scan, relative to the usual one.
    pub fit: f64,
}

impl Track {
    /// Creates particles of equal weight at these places.
    pub fn new(places: impl Iterator<Item = Place>, odds: Odds, bench: &Bench) -> Self {
        let mut particles = Particles::default();
        places.for_each(|place| particles.push(place, 1.0));
        particles.normalize();
        Self { cluster: Cluster::heaviest(&particles, &bench.binning), particles, odds, fit: 1.0 }
    }

    /// Creates `count` particles about candidates.
    pub fn about(candidates: &Candidates, count: usize, odds: Odds, bench: &mut Bench) -> Self {
        let [way, turn] = [ABOUT_CANDIDATE[0] / bench.field.resolution(), ABOUT_CANDIDATE[1]];
        let random = &mut bench.random;
        let places: Vec<Place> =
            (0..count).map(|_| candidates.draw(random).moved(way as f32, turn as f32, random)).collect();
        Self::new(places.into_iter(), odds, bench)
    }

    /// Moves the particles by a step of odometry.
    pub fn advance(&mut self, motion: &Motion, bench: &mut Bench) {
        motion.sample(&mut self.particles.places, bench.field.resolution(), &mut bench.random);
    }

    /// Normalizes the weights and finds the heaviest cluster.
    pub fn settle(&mut self, bench: &Bench) {
        self.particles.normalize();
        self.cluster = Cluster::heaviest(&self.particles, &bench.binning);
    }

    /// Weighs the particles by the scan. Returns its evidence, and the score of the best particle.
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

    /// Adds particles with this total probability.
    pub fn add(&mut self, added: &Self, probability: f64) {
        self.particles.normalize();
        self.particles.weight.iter_mut().for_each(|weight| *weight *= (1.0 - probability) as f32);
        let weight = (probability / added.particles.len() as f64) as f32;
        for nth in 0..added.particles.len() {
            self.particles.push(added.particles.places.at(nth), weight);
        }
    }

    /// Resamples the particles, as many as KLD-sampling asks for.
    pub fn resample(&mut self, bench: &mut Bench) {
        let parameters = bench.parameters;
        self.resample_with(&parameters, bench);
    }

    fn resample_with(&mut self, parameters: &Parameters, bench: &mut Bench) {
        self.particles.draw(&mut bench.spare, parameters, &bench.binning, &mut bench.random);
        std::mem::swap(&mut self.particles, &mut bench.spare);
    }

    /// Resamples the same number of particles, and moves each by the kernel of a regularized filter (Musso, Oudjane and Le
    /// Gland 2001, section 12.2.2), which has the shape of the heaviest cluster.
    fn spread(&mut self, bench: &mut Bench) {
        let count = self.particles.len();
        self.resample_with(
            &Parameters { min_particles: count, max_particles: count, ..bench.parameters },
            bench,
        );
        // Silverman's bandwidth in three dimensions, (4 / 5n)^(1/7).
        let bandwidth = (0.8 / count as f64).powf(1.0 / 7.0);
        let kernel = self.cluster.covariance.map(|entry| entry * bandwidth * bandwidth);
        self.jitter(&cholesky(&kernel), bench);
    }

    /// Moves each particle by a normal deviate, given the lower Cholesky factor of its covariance, in cells.
    pub fn jitter(&mut self, root: &[f64; 9], bench: &mut Bench) {
        let root = root.map(|entry| entry as f32);
        let Places { column, row, heading } = &mut self.particles.places;
        for ((column, row), heading) in column.iter_mut().zip(row).zip(heading) {
            let [a, b, c] = [(); 3].map(|()| bench.random.bell_f32());
            *column += root[0] * a;
            *row += root[3] * a + root[4] * b;
            *heading += root[6] * a + root[7] * b + root[8] * c;
        }
    }

    /// Returns the mean of the heaviest cluster.
    pub fn place(&self) -> Place {
        let Cluster { column, row, heading, .. } = self.cluster;
        Place { column: column as f32, row: row as f32, heading: heading as f32 }
    }
}

fn best(scores: &[f32]) -> f32 {
    scores.iter().copied().fold(f32::NEG_INFINITY, f32::max)
}
