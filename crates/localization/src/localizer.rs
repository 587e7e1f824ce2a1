//! The filter: odometry and scans go in, poses with their covariance come out.

use std::sync::Arc;

use crate::{
    belief::{Belief, cholesky},
    bins::{Binning, Cluster},
    fast::exp,
    field::{LikelihoodField, Place},
    geometry::Pose2,
    motion::Motion,
    parameters::{Parameters, Weighing},
    particles::{Elsewhere, Particles, Places},
    random::Stream,
    relocate::Candidates,
    scan::{Beams, Scan},
    weights,
};

/// Where the filter believes the robot to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean of the heaviest hypothesis.
    pub pose: Pose2,
    /// Its covariance: of x, y and heading, row by row; m², m·rad, rad².
    pub covariance: [f64; 9],
    /// How many particles there are.
    pub particles: usize,
    /// Whether the scan was used: the robot had moved far enough since the last one that was. If not, the estimate is
    /// that of the last one, moved on by odometry.
    pub updated: bool,
}

impl Estimate {
    /// Where, and how sure.
    pub fn belief(&self) -> Belief {
        Belief { pose: self.pose, covariance: self.covariance }
    }
}

/// Why a filter cannot begin, or go on.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LocalizationError {
    /// A robot can be nowhere.
    #[error("the map has no free cell, on which a robot could be")]
    NoFreeSpace,
    /// A robot says that it is at NaN or infinity.
    #[error("a pose of ({}, {}) m and {} rad is no pose", .0.x, .0.y, .0.heading)]
    NotFinite(Pose2),
}

/// Monte Carlo localization of one robot (Probabilistic Robotics, ch. 8.3), with KLD-sampling, augmented recovery and
/// global localization.
///
/// It reads no clock and draws from one seed: the same calls give the same estimates, to the bit.
#[derive(Debug, Clone)]
pub struct Localizer {
    field: Arc<LikelihoodField>,
    parameters: Parameters,
    binning: Binning,
    random: Stream,
    particles: Particles,
    /// What the last drawing left over: room for the next.
    spare: Particles,
    beams: Beams,
    scores: Vec<f32>,
    /// Odometry at the last update; `None` before the first.
    odometry: Option<Pose2>,
    /// As of the last update.
    cluster: Cluster,
    recovery: Recovery,
    updates: u32,
    /// How many updates in a row fitted badly.
    unfit: u32,
    /// Nothing is known of where it is before the first scan.
    anywhere: bool,
}

/// Of the particles, no more than this share are lost to one step of weighing: a sharp likelihood is taken in steps.
const LEAST_EFFECTIVE: f64 = 0.1;
/// So many steps at most.
const STEPS: usize = 5;
/// Places looked at when nothing is known, and when it seems that the robot was carried away.
const MOST_CANDIDATES: [usize; 2] = [1_000_000, 20_000];
/// Of the beams, as many are enough to find candidates.
const CANDIDATE_BEAMS: usize = 40;
/// For so many updates that fit badly, it is odometry that was off, and the robot is looked for near where it should be.
const LOOK_NEAR: u32 = 4;
/// How likely it is that a robot whose scans fit badly was carried away, rather than that somebody stands before it. A
/// scan that fits elsewhere outweighs that at once; a place that only looks alike does not.
const KIDNAPPED: f64 = 1e-8;
/// Deviation of particles about a candidate, metres and radians.
const ABOUT_CANDIDATE: [f64; 2] = [0.05, 0.02];

impl Localizer {
    /// A filter that knows about where the robot is: a normal distribution, its covariance row by row.
    ///
    /// # Errors
    /// [`LocalizationError::NotFinite`].
    pub fn at(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
        pose: Pose2,
        covariance: &[f64; 9],
    ) -> Result<Self, LocalizationError> {
        if !(pose.is_finite() && covariance.iter().all(|entry| entry.is_finite())) {
            return Err(LocalizationError::NotFinite(pose));
        }
        let mut localizer = Self::new(field, parameters, seed);
        let centre = localizer.field.place(pose);
        localizer.particles.clear();
        for _ in 0..parameters.max_particles.min(4 * parameters.min_particles) {
            localizer.particles.push(centre, 1.0);
        }
        let root = cholesky(&in_cells(covariance, localizer.field.resolution()));
        localizer.jitter(&root);
        localizer.settle();
        Ok(localizer)
    }

    /// A filter that knows nothing: the robot may be on any free cell, and look anywhere.
    ///
    /// # Errors
    /// [`LocalizationError::NoFreeSpace`].
    pub fn anywhere(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
    ) -> Result<Self, LocalizationError> {
        let mut localizer = Self::new(field, parameters, seed);
        for _ in 0..parameters.max_particles {
            let place = localizer.field.anywhere(&mut localizer.random);
            localizer.particles.push(place.ok_or(LocalizationError::NoFreeSpace)?, 1.0);
        }
        localizer.anywhere = true;
        localizer.settle();
        Ok(localizer)
    }

    fn new(field: Arc<LikelihoodField>, parameters: Parameters, seed: u64) -> Self {
        let mut particles = Particles::default();
        particles.push(field.place(Pose2::default()), 1.0);
        let binning = Binning::new(field.resolution());
        Self {
            cluster: Cluster::heaviest(&particles, &binning),
            particles: Particles::default(),
            spare: Particles::default(),
            random: Stream::new(seed),
            beams: Beams::default(),
            scores: Vec::new(),
            odometry: None,
            recovery: Recovery::default(),
            updates: 0,
            unfit: 0,
            anywhere: false,
            binning,
            field,
            parameters,
        }
    }

    /// Takes in where odometry says that the robot is, in whatever frame it began, and what its lidar sees there.
    ///
    /// # Errors
    /// [`LocalizationError::NotFinite`] if odometry is; nothing has changed then.
    pub fn observe(&mut self, odometry: Pose2, scan: &Scan<'_>) -> Result<Estimate, LocalizationError> {
        if !odometry.is_finite() {
            return Err(LocalizationError::NotFinite(odometry));
        }
        let step = self.odometry.map(|last| last.step_to(odometry));
        let far = |step: Pose2| {
            step.x.hypot(step.y) >= self.parameters.update_distance
                || step.heading.abs() >= self.parameters.update_angle
        };
        if let Some(step) = step
            && !far(step)
        {
            return Ok(self.moved_on(step));
        }
        self.beams.take(scan, &self.parameters.beams, self.parameters.weighing);
        if self.beams.votes == 0.0 && step.is_some() {
            // A lidar that sees nothing says nothing; the motion is sampled with the next scan that does.
            return Ok(self.moved_on(step.unwrap_or_default()));
        }
        let per_cell = self.field.resolution().recip() as f32;
        self.beams.x.iter_mut().chain(&mut self.beams.y).for_each(|end| *end *= per_cell);
        self.odometry = Some(odometry);
        if let Some(step) = step {
            let motion = Motion::new(step, &self.parameters.motion);
            motion.sample(&mut self.particles.places, self.field.resolution(), &mut self.random);
        }
        if std::mem::take(&mut self.anywhere) && self.weighs_by_likelihood() {
            self.scatter();
        }
        self.weigh();
        self.settle();
        self.updates += 1;
        self.draw_anew();
        Ok(self.estimate(true))
    }

    /// The estimate as of the last update, with what odometry says since.
    fn moved_on(&self, step: Pose2) -> Estimate {
        let last = self.estimate(false);
        let Belief { pose, covariance } = last.belief().moved_on(step, &self.parameters.motion);
        Estimate { pose, covariance, ..last }
    }

    fn estimate(&self, updated: bool) -> Estimate {
        let Cluster { column, row, heading, covariance } = self.cluster;
        let resolution = self.field.resolution();
        let mut covariance = in_cells(&covariance, resolution.recip());
        if self.weighs_by_likelihood() {
            // Walls are anywhere in their cells, alike for all scans: a uniform error, which no number of beams lessens.
            let cell = resolution.powi(2) / 12.0;
            covariance[0] += cell;
            covariance[4] += cell;
        }
        Estimate {
            pose: self.field.pose(column, row, heading),
            covariance,
            particles: self.particles.len(),
            updated,
        }
    }

    fn weighs_by_likelihood(&self) -> bool {
        matches!(self.parameters.weighing, Weighing::Likelihood { .. })
    }

    /// Normalizes the weights, and finds the heaviest hypothesis.
    fn settle(&mut self) {
        self.particles.normalize();
        self.cluster = Cluster::heaviest(&self.particles, &self.binning);
    }

    fn score(&mut self) {
        self.field.score(&self.particles.places, &self.beams, &mut self.scores);
    }

    /// Weighs the particles by the scan.
    fn weigh(&mut self) {
        self.score();
        if !self.weighs_by_likelihood() {
            let weights = self.particles.weight.iter_mut().zip(&self.scores);
            let sum: f64 = weights
                .map(|(weight, score)| {
                    *weight *= 1.0 + score;
                    f64::from(*weight)
                })
                .sum();
            return self.recovery.see(sum, self.parameters.recovery);
        }
        let votes = self.beams.votes;
        let typical = |(weight, score): (&f32, &f32)| f64::from(weight * exp(score / votes));
        let seen: f64 = self.particles.weight.iter().zip(&self.scores).map(typical).sum();
        self.recovery.see(seen, self.parameters.recovery);
        let mut rest = 1.0;
        for _ in 1..STEPS {
            let least = LEAST_EFFECTIVE * self.particles.len() as f64;
            let share = weights::tempered(&self.particles.weight, &self.scores, least);
            if share == 1.0 {
                break;
            }
            weights::multiply(&mut self.particles.weight, &self.scores, share);
            rest *= 1.0 - share;
            self.settle();
            self.spread();
            self.score();
            self.scores.iter_mut().for_each(|score| *score *= rest);
        }
        weights::multiply(&mut self.particles.weight, &self.scores, 1.0);
    }

    /// Draws as many particles as there are, each a little off its parent: the kernel of a regularized filter (Musso,
    /// Oudjane and Le Gland 2001, section 12.2.2), shaped as the heaviest hypothesis.
    fn spread(&mut self) {
        let count = self.particles.len();
        let fixed = Parameters { min_particles: count, max_particles: count, ..self.parameters };
        let nobody = &mut |_: &mut Stream| Place::default();
        let elsewhere = Elsewhere { probability: 0.0, mass: None, place: nobody };
        self.particles.draw(&mut self.spare, &fixed, &self.binning, &mut self.random, elsewhere);
        std::mem::swap(&mut self.particles, &mut self.spare);
        // Silverman's bandwidth in three dimensions, (4 / 5n)^(1/7).
        let bandwidth = (0.8 / count as f64).powf(1.0 / 7.0);
        let kernel = self.cluster.covariance.map(|entry| entry * bandwidth * bandwidth);
        self.jitter(&cholesky(&kernel));
    }

    /// Moves each particle by a normal deviate, given the lower root of its covariance, in cells.
    fn jitter(&mut self, root: &[f64; 9]) {
        let root = root.map(|entry| entry as f32);
        let Places { column, row, heading } = &mut self.particles.places;
        for ((column, row), heading) in column.iter_mut().zip(row).zip(heading) {
            let [a, b, c] = [(); 3].map(|()| self.random.bell());
            *column += root[0] * a;
            *row += root[3] * a + root[4] * b;
            *heading += root[6] * a + root[7] * b + root[8] * c;
        }
    }

    /// Puts all particles where the scan could have been taken.
    fn scatter(&mut self) {
        let Some(candidates) = self.candidates(MOST_CANDIDATES[0]) else { return };
        let count = self.parameters.max_particles.min(10 * self.parameters.min_particles);
        self.particles.clear();
        for _ in 0..count {
            self.particles.push(candidates.draw(&mut self.random), 1.0);
        }
        let [way, turn] = ABOUT_CANDIDATE;
        let way = way / self.field.resolution();
        self.jitter(&[way, 0.0, 0.0, 0.0, way, 0.0, 0.0, 0.0, turn]);
        self.particles.normalize();
    }

    fn candidates(&mut self, most: usize) -> Option<Candidates> {
        Candidates::find(&self.field, &self.beams.some(CANDIDATE_BEAMS), most, &mut self.random)
    }

    fn near(&mut self) -> Candidates {
        let Cluster { column, row, heading, .. } = self.cluster;
        let place = Place { column: column as f32, row: row as f32, heading: heading as f32 };
        Candidates::near(place, &self.field, &self.beams.some(CANDIDATE_BEAMS), &mut self.random)
    }

    /// Draws particles anew when it is time: as many as KLD-sampling asks for, and some from elsewhere when scans fit
    /// worse than they used to.
    fn draw_anew(&mut self) {
        let due = match self.parameters.resample_interval {
            Some(interval) => self.updates.is_multiple_of(interval.max(1)),
            None => self.particles.effective() < 0.5 * self.particles.len() as f64,
        };
        let lost = self.recovery.probability(self.parameters.recovery_threshold);
        if !due && lost == 0.0 {
            return;
        }
        self.unfit = if lost > 0.0 { self.unfit + 1 } else { 0 };
        let far = self.unfit > LOOK_NEAR;
        let mut candidates = None;
        if lost > 0.0 && self.weighs_by_likelihood() {
            candidates = if far { self.candidates(MOST_CANDIDATES[1]) } else { Some(self.near()) };
        }
        let field = &self.field;
        let mut anew = |random: &mut Stream| {
            let place = match &candidates {
                Some(candidates) => Some(candidates.draw(random)),
                None => field.anywhere(random),
            };
            place.unwrap_or_default()
        };
        let mass = (self.weighs_by_likelihood() && far).then_some(KIDNAPPED);
        let elsewhere = Elsewhere { probability: lost, mass, place: &mut anew };
        self.particles.draw(&mut self.spare, &self.parameters, &self.binning, &mut self.random, elsewhere);
        std::mem::swap(&mut self.particles, &mut self.spare);
    }
}

/// How well scans fit, in the short and in the long run (Probabilistic Robotics, table 8.3).
#[derive(Debug, Clone, Copy, Default)]
struct Recovery {
    slow: Option<f64>,
    fast: f64,
}

impl Recovery {
    fn see(&mut self, fit: f64, [slow_rate, fast_rate]: [f64; 2]) {
        if slow_rate <= 0.0 || fast_rate <= 0.0 {
            return;
        }
        match &mut self.slow {
            None => (self.slow, self.fast) = (Some(fit), fit),
            Some(slow) => {
                *slow += slow_rate * (fit - *slow);
                self.fast += fast_rate * (fit - self.fast);
            }
        }
    }

    /// Of a particle to come from elsewhere.
    fn probability(&self, threshold: f64) -> f64 {
        self.slow.map_or(0.0, |slow| (1.0 - threshold * self.fast / slow).max(0.0))
    }
}

/// A covariance with its lengths divided by `unit`.
fn in_cells(covariance: &[f64; 9], unit: f64) -> [f64; 9] {
    let scale = [unit.recip(), unit.recip(), 1.0];
    std::array::from_fn(|i| covariance[i] * scale[i / 3] * scale[i % 3])
}
