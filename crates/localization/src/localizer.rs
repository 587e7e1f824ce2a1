//! The filter: odometry and scans go in, poses with their covariance come out.

use std::sync::Arc;

use crate::{
    belief::{Belief, cholesky},
    bins::{Binning, Cluster},
    doubt::Doubt,
    field::{LikelihoodField, Place},
    geometry::{FARTHEST, Pose2},
    motion::Motion,
    parameters::{Parameters, Weighing},
    particles::{Particles, Places},
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
    /// All scans would look alike.
    #[error("the map has no wall, by which a robot could be found")]
    NoWall,
    /// A pose is not finite, or so far away that computing with it overflows.
    #[error("({:?}, {:?}) m and {:?} rad is no pose: not finite, or beyond {FARTHEST:e} m", .0.x, .0.y, .0.heading)]
    NoPose(Pose2),
    /// A covariance is not finite, or so large that computing with it overflows.
    #[error("a variance of {0} is no use: not finite, or above ({FARTHEST:e} m)²")]
    NoCovariance(f64),
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
    updates: u32,
    doubt: Doubt,
    /// Nothing is known of where it is before the first scan.
    anywhere: bool,
}

/// Of the particles, no more than this share are lost to one step of weighing: a sharp likelihood is taken in steps.
const LEAST_EFFECTIVE: f64 = 0.05;
/// So many steps at most.
const STEPS: usize = 5;
/// Places looked at when nothing is known.
const MOST_CANDIDATES: usize = 1_000_000;
/// Places looked at after a scan that fits badly, and how often their number doubles with each further one.
const CANDIDATES: usize = 50_000;
const DOUBLED: u32 = 4;
/// Of the beams, as many are enough to find candidates.
const CANDIDATE_BEAMS: usize = 40;
/// Logarithms of the odds that a robot whose scan fits badly slipped, or was carried away, to the one place near by, or
/// anywhere, that fits best.
const SLIPPED: f64 = -11.5;
const CARRIED_AWAY: f64 = -18.4;
/// A scan says no more of where else the robot is than so many votes would: the place was chosen to fit.
const MOST_VOTES: f64 = 25.0;
/// A place far away fits if such a share of the votes that usually are at walls is.
const FITS: f64 = 0.65;
/// No odds need a larger logarithm.
const LARGEST: f64 = 50.0;
/// Less likely places are left out.
const NEGLIGIBLE: f64 = 1e-4;
/// Deviation of particles about a candidate, metres and radians.
const ABOUT_CANDIDATE: [f64; 2] = [0.05, 0.02];

impl Localizer {
    /// A filter that knows about where the robot is: a normal distribution, its covariance row by row.
    ///
    /// # Errors
    /// [`LocalizationError`] if the map, the pose or the covariance is no use.
    pub fn at(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
        pose: Pose2,
        covariance: &[f64; 9],
    ) -> Result<Self, LocalizationError> {
        valid(pose)?;
        let most = FARTHEST * FARTHEST;
        // NaN is not within either.
        if let Some(entry) = covariance.iter().find(|entry| !(-most..=most).contains(*entry)) {
            return Err(LocalizationError::NoCovariance(*entry));
        }
        let mut localizer = Self::new(field, parameters, seed)?;
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
    /// [`LocalizationError::NoFreeSpace`] and [`LocalizationError::NoWall`].
    pub fn anywhere(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
    ) -> Result<Self, LocalizationError> {
        let mut localizer = Self::new(field, parameters, seed)?;
        for _ in 0..parameters.max_particles {
            let place = localizer.field.anywhere(&mut localizer.random);
            localizer.particles.push(place.ok_or(LocalizationError::NoFreeSpace)?, 1.0);
        }
        localizer.anywhere = true;
        localizer.doubt = Doubt::even();
        localizer.settle();
        Ok(localizer)
    }

    fn new(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
    ) -> Result<Self, LocalizationError> {
        field.check()?;
        let mut particles = Particles::default();
        particles.push(field.place(Pose2::default()), 1.0);
        let binning = Binning::new(field.resolution());
        Ok(Self {
            cluster: Cluster::heaviest(&particles, &binning),
            particles: Particles::default(),
            spare: Particles::default(),
            random: Stream::new(seed),
            beams: Beams::default(),
            scores: Vec::new(),
            odometry: None,
            updates: 0,
            doubt: Doubt::none(),
            anywhere: false,
            binning,
            field,
            parameters,
        })
    }

    /// Takes in where odometry says that the robot is, in whatever frame it began, and what its lidar sees there.
    ///
    /// # Errors
    /// [`LocalizationError::NoPose`] if odometry, or what the scan says of its mount or sweep, is none; nothing has
    /// changed then.
    pub fn observe(&mut self, odometry: Pose2, scan: &Scan<'_>) -> Result<Estimate, LocalizationError> {
        for pose in [odometry, scan.mount, scan.sweep] {
            valid(pose)?;
        }
        let step = self.odometry.map(|last| last.step_to(odometry));
        let far = |step: Pose2| {
            step.x.hypot(step.y) >= self.parameters.update_distance
                || step.heading.abs() >= self.parameters.update_angle
        };
        if let Some(step) = step
            && self.updates > 0
            && !far(step)
        {
            return Ok(self.moved_on(step));
        }
        self.beams.take(scan, &self.parameters.beams, self.parameters.weighing);
        if self.beams.votes == 0.0 {
            // A lidar that sees nothing says nothing; the motion is sampled with the next scan that does.
            self.odometry = self.odometry.or(Some(odometry));
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
        let Cluster { column, row, heading, about: mut covariance, .. } = self.cluster;
        let resolution = self.field.resolution();
        let lost = if self.weighs_by_likelihood() { self.doubt.probability() } else { 0.0 };
        for (entry, anywhere) in covariance.iter_mut().zip(self.field.anywhere_about(column, row)) {
            *entry += lost * (anywhere - *entry);
        }
        let mut covariance = in_cells(&covariance, resolution.recip());
        if self.weighs_by_likelihood() {
            // Walls are anywhere in their cells, alike for all scans: a uniform error, which no number of beams lessens.
            let cell = resolution.powi(2) / 12.0;
            let [way, turn] = self.parameters.systematic;
            covariance[0] += cell + way * way;
            covariance[4] += cell + way * way;
            covariance[8] += turn * turn;
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
            return weights.for_each(|(weight, score)| *weight *= 1.0 + score);
        }
        let mut evidence = 0.0;
        let mut rest = 1.0;
        for _ in 1..STEPS {
            let least = LEAST_EFFECTIVE * self.particles.len() as f64;
            let share = weights::tempered(&self.particles.weight, &self.scores, least);
            if share == 1.0 {
                break;
            }
            evidence += weights::multiply(&mut self.particles.weight, &self.scores, share);
            rest *= 1.0 - share;
            self.settle();
            self.spread();
            self.score();
            self.scores.iter_mut().for_each(|score| *score *= rest);
        }
        evidence += weights::multiply(&mut self.particles.weight, &self.scores, 1.0);
        self.doubt.see(self.best_fit(rest), self.beams.votes.into());
        if self.doubt.bad() > 0 {
            self.look_elsewhere(evidence);
        }
    }

    /// Which share of the votes is at walls where the scan fits best; scores are this share of the whole ones.
    fn best_fit(&self, whole: f32) -> f64 {
        self.field.hit_share(best(&self.scores) / whole, self.beams.votes)
    }

    /// Adds places from which the scan could have been taken, near by and everywhere, with the probability that they
    /// have beside the particles, whose evidence is given. They get half of it at most: the next scan, by which they
    /// were not chosen, decides.
    fn look_elsewhere(&mut self, evidence: f64) {
        let trust = (MOST_VOTES / f64::from(self.beams.votes)).min(1.0);
        let most = CANDIDATES << (self.doubt.bad() - 1).min(DOUBLED);
        let far = self.candidates(most).map(|far| (far, CARRIED_AWAY));
        let mut found = vec![(self.near(), SLIPPED)];
        found.extend(far);
        let mut odds = Vec::new();
        for (candidates, prior) in &found {
            self.field.score(candidates.places(), &self.beams, &mut self.scores);
            let better = trust * (f64::from(best(&self.scores)) - evidence);
            // A place far away that fits badly, too, is no better an explanation than a crowd about the robot.
            let none = *prior == CARRIED_AWAY && self.doubt.relative(self.best_fit(1.0)) < FITS;
            odds.push(if none { 0.0 } else { (prior + better).min(LARGEST).exp() });
        }
        let all: f64 = odds.iter().sum();
        let elsewhere = (all / (1.0 + all)).min(0.5);
        self.particles.normalize();
        self.particles.weight.iter_mut().for_each(|weight| *weight *= (1.0 - elsewhere) as f32);
        let [way, turn] = [ABOUT_CANDIDATE[0] / self.field.resolution(), ABOUT_CANDIDATE[1]];
        let count = self.parameters.min_particles;
        for ((candidates, _), odds) in found.iter().zip(odds) {
            let probability = elsewhere * odds / all;
            // It is NaN if there is nothing elsewhere.
            let kept = if probability > NEGLIGIBLE { count } else { 0 };
            for _ in 0..kept {
                let place =
                    candidates.draw(&mut self.random).moved(way as f32, turn as f32, &mut self.random);
                self.particles.push(place, (probability / count as f64) as f32);
            }
        }
    }

    /// Draws as many particles as there are, each a little off its parent: the kernel of a regularized filter (Musso,
    /// Oudjane and Le Gland 2001, section 12.2.2), shaped as the heaviest hypothesis.
    fn spread(&mut self) {
        let count = self.particles.len();
        let fixed = Parameters { min_particles: count, max_particles: count, ..self.parameters };
        self.particles.draw(&mut self.spare, &fixed, &self.binning, &mut self.random);
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
        let Some(candidates) = self.candidates(MOST_CANDIDATES) else { return };
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

    /// Draws particles anew when it is time: as many as KLD-sampling asks for.
    fn draw_anew(&mut self) {
        let due = match self.parameters.resample_interval {
            Some(interval) => self.updates.is_multiple_of(interval.max(1)),
            None => self.particles.effective() < 0.5 * self.particles.len() as f64,
        };
        // Else their number would grow with each look elsewhere.
        if due || self.doubt.bad() > 0 {
            self.particles.draw(&mut self.spare, &self.parameters, &self.binning, &mut self.random);
            std::mem::swap(&mut self.particles, &mut self.spare);
        }
    }
}

fn best(scores: &[f32]) -> f32 {
    scores.iter().copied().fold(f32::NEG_INFINITY, f32::max)
}

fn valid(pose: Pose2) -> Result<(), LocalizationError> {
    if pose.is_valid() { Ok(()) } else { Err(LocalizationError::NoPose(pose)) }
}

/// A covariance with its lengths divided by `unit`.
fn in_cells(covariance: &[f64; 9], unit: f64) -> [f64; 9] {
    let scale = [unit.recip(), unit.recip(), 1.0];
    std::array::from_fn(|i| covariance[i] * scale[i / 3] * scale[i % 3])
}
