//! The particle filter of one robot: odometry and scans go in, poses with their covariance come out.

use std::sync::Arc;

use crate::{
    belief::{Belief, cholesky},
    cluster::Cluster,
    disagreement,
    doubt::{Odds, Usual, neutral},
    error::LocalizationError,
    field::LikelihoodField,
    geometry::{FARTHEST, Pose2},
    motion::Motion,
    parameters::Parameters,
    place::{Place, Places},
    relocate::Candidates,
    scan::Scan,
    track::{Bench, Track},
};

/// Estimated pose of a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean of the heaviest hypothesis.
    pub pose: Pose2,
    /// Covariance of x, y and heading, row by row; m², m·rad, rad².
    pub covariance: [f64; 9],
    /// Number of particles.
    pub particles: usize,
    /// Whether the scan was used, because the robot had moved far enough since the last used one. If not, this is the last
    /// estimate, moved on by odometry.
    pub updated: bool,
}

impl Estimate {
    /// Returns the pose with its covariance.
    pub fn belief(&self) -> Belief {
        Belief { pose: self.pose, covariance: self.covariance }
    }
}

/// Monte Carlo localization of one robot (Probabilistic Robotics, ch. 8.3), with KLD-sampling, augmented recovery and
/// global localization.
///
/// It draws from one seed: the same calls give the same estimates, to the bit.
#[derive(Debug, Clone)]
pub struct Localizer {
    bench: Bench,
    /// The hypothesis whose heaviest cluster is the estimate.
    followed: Track,
    /// Other hypotheses, created when scans fit badly.
    others: Vec<Track>,
    usual: Usual,
    /// Odometry at the last update; `None` before the first.
    odometry: Option<Pose2>,
    /// Second moments about the estimate as of the last update, in cells.
    about: [f64; 9],
    /// Covariance by which the parts of the last used scan disagree, in cells.
    disagreement: [f64; 9],
    updates: u32,
    /// Whether the first scan is still to locate the robot on the whole map.
    anywhere: bool,
}

/// Number of beams by which candidates are sought.
const CANDIDATE_BEAMS: usize = 40;
/// Log odds that a robot with a badly fitting scan slipped to the place near by that fits best.
const SLIPPED: f64 = -11.5;
/// Largest number of votes of a scan for a place near by, because the place was chosen to fit.
const MOST_VOTES: f64 = 25.0;
/// Relative fit below which better places near by are sought.
const NEAR: f64 = 0.8;
/// Smallest advantage in relative fit that makes a distant place a hypothesis.
const BETTER: f64 = 0.1;
/// Drop in relative fit at which a standing robot is sought anew.
const WORSE: f64 = 0.2;
/// Cap of log odds before they are exponentiated.
const LARGEST: f64 = 50.0;
/// Probability below which places are left out.
const NEGLIGIBLE: f64 = 1e-4;
/// Largest number of other hypotheses.
const OTHERS: usize = 2;
/// Advantage in log odds at which another hypothesis is followed instead: over the followed one, and over no known
/// hypothesis at all (0). It also needs the share [`CLEAR`] of its weight in one cluster.
const TAKES_OVER: f64 = 2.0;
const CLEAR: f64 = 0.7;
/// Deficit in log odds at which a hypothesis is given up.
const GIVEN_UP: f64 = 15.0;
/// Distance between clusters below which they are the same place, metres.
const SAME: f64 = 0.5;

impl Localizer {
    /// Creates a filter for a robot with a known start: a normal distribution with this covariance, row by row.
    ///
    /// # Errors
    /// [`LocalizationError`] if the map, the pose or the covariance is not usable.
    pub fn at(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
        pose: Pose2,
        covariance: &[f64; 9],
    ) -> Result<Self, LocalizationError> {
        valid(pose)?;
        let most = FARTHEST * FARTHEST;
        // NaN is not in the range either.
        if let Some(entry) = covariance.iter().find(|entry| !(-most..=most).contains(*entry)) {
            return Err(LocalizationError::NoCovariance(*entry));
        }
        let mut bench = Self::bench(field, parameters, seed)?;
        let centre = bench.field.place(pose);
        let count = parameters.max_particles.min(4 * parameters.min_particles);
        let mut followed = Track::new((0..count).map(|_| centre), Odds::sure(), &bench);
        followed.jitter(&cholesky(&in_cells(covariance, bench.field.resolution())), &mut bench);
        followed.settle(&bench);
        Ok(Self::new(bench, followed))
    }

    /// Creates a filter for a robot that may be on any free cell, with any heading.
    ///
    /// # Errors
    /// [`LocalizationError::NoFreeSpace`] and [`LocalizationError::NoWall`].
    pub fn anywhere(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
    ) -> Result<Self, LocalizationError> {
        let mut bench = Self::bench(field, parameters, seed)?;
        let anywhere = |_| bench.field.anywhere(&mut bench.random);
        let places: Option<Vec<Place>> = (0..parameters.max_particles).map(anywhere).collect();
        let places = places.ok_or(LocalizationError::NoFreeSpace)?;
        let followed = Track::new(places.into_iter(), Odds::even(), &bench);
        Ok(Self { anywhere: true, ..Self::new(bench, followed) })
    }

    fn bench(
        field: Arc<LikelihoodField>,
        parameters: Parameters,
        seed: u64,
    ) -> Result<Bench, LocalizationError> {
        field.check()?;
        Ok(Bench::new(field, parameters, seed))
    }

    fn new(bench: Bench, followed: Track) -> Self {
        let mut localizer = Self {
            bench,
            followed,
            others: Vec::new(),
            usual: Usual::new(),
            odometry: None,
            about: [0.0; 9],
            disagreement: [0.0; 9],
            updates: 0,
            anywhere: false,
        };
        localizer.about = localizer.mixture();
        localizer
    }

    /// Updates the estimate with the robot's pose by odometry, in any fixed frame, and the scan taken there.
    ///
    /// # Errors
    /// [`LocalizationError::NoPose`] if the odometry or the scan's mount or sweep is not valid. The filter is unchanged then.
    pub fn observe(&mut self, odometry: Pose2, scan: &Scan<'_>) -> Result<Estimate, LocalizationError> {
        for pose in [odometry, scan.mount, scan.sweep] {
            valid(pose)?;
        }
        let step = self.odometry.map(|last| last.step_to(odometry));
        let parameters = self.bench.parameters;
        let far = |step: Pose2| {
            step.x.hypot(step.y) >= parameters.update_distance
                || step.heading.abs() >= parameters.update_angle
        };
        let near = step.filter(|step| self.updates > 0 && !far(*step));
        if let Some(step) = near
            && !self.bench.weighs_by_likelihood()
        {
            return Ok(self.moved_on(step));
        }
        let beams = &mut self.bench.beams;
        beams.take(scan, &parameters.beams, parameters.weighing);
        if beams.votes == 0.0 {
            // Nothing was seen. The motion is sampled with the next usable scan.
            self.odometry = self.odometry.or(Some(odometry));
            return Ok(self.moved_on(step.unwrap_or_default()));
        }
        let per_cell = self.bench.field.resolution().recip() as f32;
        beams.x.iter_mut().chain(&mut beams.y).for_each(|end| *end *= per_cell);
        if let Some(step) = near
            && !self.is_unexpected(step)
        {
            return Ok(self.moved_on(step));
        }
        self.odometry = Some(odometry);
        self.update(step, near.is_some());
        Ok(self.estimate(true))
    }

    /// Whether the scan of a robot that has hardly moved no longer fits, as when it was carried away.
    fn is_unexpected(&mut self, step: Pose2) -> bool {
        let Place { column, row, heading } = self.followed.place();
        let pose = self.bench.field.pose(column.into(), row.into(), heading.into()) * step;
        let mut places = Places::default();
        places.push(self.bench.field.place(pose));
        let score = self.bench.best(&places);
        let fit = self.usual.relative(self.bench.hit_share(score));
        fit < neutral(self.bench.beams.votes.into()) && fit < self.followed.fit - WORSE
    }

    fn update(&mut self, step: Option<Pose2>, is_unexpected: bool) {
        let step = step.unwrap_or_default();
        let motion = Motion::new(step, &self.bench.parameters.motion);
        for track in std::iter::once(&mut self.followed).chain(&mut self.others) {
            track.advance(&motion, &mut self.bench);
        }
        if std::mem::take(&mut self.anywhere) && self.bench.weighs_by_likelihood() {
            self.scatter();
        }
        let [evidence, score] = self.followed.weigh(&mut self.bench);
        self.updates += 1;
        if self.bench.weighs_by_likelihood() {
            // An unexpected scan counts in full, although the robot has not moved.
            let way = if is_unexpected { f64::INFINITY } else { step.x.hypot(step.y) + step.heading.abs() };
            self.judge(evidence, score, way);
        }
        self.followed.settle(&self.bench);
        self.about = self.mixture();
        if self.bench.weighs_by_likelihood() && self.bench.parameters.disagreement > 0.0 {
            let Bench { field, beams, parameters, .. } = &self.bench;
            let sigma = parameters.beams.sigma_hit;
            self.disagreement = disagreement::covariance(field, beams, sigma, &self.followed.cluster);
        }
        // Each search near by adds particles.
        let crowded = self.followed.particles.len() > self.bench.parameters.max_particles;
        let due = match self.bench.parameters.resample_interval {
            Some(interval) => self.updates.is_multiple_of(interval.max(1)),
            None => self.followed.particles.effective() < 0.5 * self.followed.particles.len() as f64,
        };
        if due || crowded {
            self.followed.resample(&mut self.bench);
        }
    }

    /// Updates the odds of all hypotheses by the scan, seeks others if none fits, and follows another one if it is clearly
    /// better.
    fn judge(&mut self, evidence: f64, score: f64, way: f64) {
        let votes = self.bench.beams.votes.into();
        let neutral = neutral(votes);
        let share = self.bench.hit_share(score);
        let fit = self.usual.relative(share);
        self.followed.odds.record(fit, votes, way);
        if self.followed.odds.is_followed() && self.others.is_empty() {
            self.usual.learn(share, fit < neutral);
        }
        self.followed.fit = fit;
        let mut explained = fit >= neutral;
        for track in &mut self.others {
            let [_, score] = track.weigh(&mut self.bench);
            let fit = self.usual.relative(self.bench.hit_share(score));
            track.fit = fit;
            track.odds.record(fit, votes, way);
            explained |= fit >= neutral;
            track.settle(&self.bench);
            track.resample(&mut self.bench);
        }
        self.limit();
        if fit < NEAR {
            self.look_near(evidence);
        }
        self.followed.settle(&self.bench);
        if !explained {
            self.look_elsewhere(fit.max(neutral - BETTER));
        }
        self.weed();
        let log = self.followed.odds.log();
        let better =
            |track: &Track| track.odds.log() > log.max(0.0) + TAKES_OVER && track.cluster.share >= CLEAR;
        let best = (0..self.others.len()).filter(|&nth| better(&self.others[nth]));
        let best = best.max_by(|&a, &b| self.others[a].odds.log().total_cmp(&self.others[b].odds.log()));
        if let Some(best) = best {
            std::mem::swap(&mut self.followed, &mut self.others[best]);
        }
    }

    /// Caps the odds of each hypothesis, and lowers those of the others by the excess.
    fn limit(&mut self) {
        let excess = self.followed.odds.limit();
        self.others.iter_mut().for_each(|track| track.odds.lower(excess));
        for nth in 0..self.others.len() {
            let excess = self.others[nth].odds.limit();
            let others = self.others.iter_mut().enumerate().filter(|(other, _)| *other != nth);
            others.for_each(|(_, track)| track.odds.lower(excess));
            self.followed.odds.lower(excess);
        }
    }

    /// Drops hypotheses that are far less likely than the followed one, or at the same place as another.
    fn weed(&mut self) {
        let resolution = self.bench.field.resolution();
        let same = |a: &Track, b: &Track| {
            let off = (a.cluster.column - b.cluster.column).hypot(a.cluster.row - b.cluster.row);
            off * resolution < SAME
        };
        let mut kept: Vec<Track> = Vec::new();
        for track in self.others.drain(..) {
            let unlikely = track.odds.log() < self.followed.odds.log() - GIVEN_UP;
            if !unlikely && !same(&track, &self.followed) && !kept.iter().any(|other| same(other, &track)) {
                kept.push(track);
            }
        }
        self.others = kept;
    }

    /// Returns the last estimate, moved on by odometry.
    fn moved_on(&self, step: Pose2) -> Estimate {
        let last = self.estimate(false);
        let Belief { pose, covariance } = last.belief().moved_on(step, &self.bench.parameters.motion);
        Estimate { pose, covariance, ..last }
    }

    fn estimate(&self, updated: bool) -> Estimate {
        let Cluster { column, row, heading, .. } = self.followed.cluster;
        let resolution = self.bench.field.resolution();
        let parameters = &self.bench.parameters;
        let all = std::array::from_fn(|i| self.about[i] + parameters.disagreement * self.disagreement[i]);
        let mut covariance = in_cells(&all, resolution.recip());
        if self.bench.weighs_by_likelihood() {
            // A wall may be anywhere in its cell: a uniform error that all scans share, so that more beams do not reduce
            // it.
            let cell = resolution.powi(2) / 12.0;
            let [way, turn] = parameters.systematic;
            covariance[0] += cell + way * way;
            covariance[4] += cell + way * way;
            covariance[8] += turn * turn;
        }
        Estimate {
            pose: self.bench.field.pose(column, row, heading),
            covariance,
            particles: self.followed.particles.len(),
            updated,
        }
    }

    /// Returns the second moments about the estimate: of all hypotheses and of a robot anywhere on the map, weighted by
    /// their probabilities.
    fn mixture(&self) -> [f64; 9] {
        let cluster = &self.followed.cluster;
        let all = |track: &Track| cluster.second_moments(&track.particles, 0..track.particles.len());
        let followed = if cluster.share < 1.0 { all(&self.followed) } else { cluster.covariance };
        if !self.bench.weighs_by_likelihood() {
            return followed;
        }
        let anywhere = self.bench.field.anywhere_about(cluster.column, cluster.row);
        let others = self.others.iter().map(|track| (track.odds.log().exp(), all(track)));
        let parts = others.chain([(self.followed.odds.log().exp(), followed), (1.0, anywhere)]);
        let (mut sum, mut moments) = (0.0, [0.0; 9]);
        for (weight, part) in parts {
            sum += weight;
            moments.iter_mut().zip(part).for_each(|(moment, part)| *moment += weight * part);
        }
        moments.map(|moment| moment / sum)
    }

    /// Adds particles at places near by that fit the scan, with their probability against the present particles, whose
    /// evidence is given. They get at most half of it, because they were chosen by this scan; the next one decides.
    fn look_near(&mut self, evidence: f64) {
        let trust = (MOST_VOTES / f64::from(self.bench.beams.votes)).min(1.0);
        let beams = self.bench.beams.some(CANDIDATE_BEAMS);
        // The cluster is still that of the last update.
        self.followed.settle(&self.bench);
        let place = self.followed.place();
        let found = Candidates::near(place, &self.bench.field, &beams, &mut self.bench.random);
        let better = trust * (self.bench.best(found.places()) - evidence);
        let odds = (SLIPPED + better).min(LARGEST).exp();
        let probability = (odds / (1.0 + odds)).min(0.5);
        if probability > NEGLIGIBLE {
            let count = self.bench.parameters.min_particles;
            let added = Track::about(&found, count, Odds::even(), &mut self.bench);
            self.followed.add(&added, probability);
        }
    }

    /// Searches the map for places with a clearly better fit, and makes them a hypothesis.
    fn look_elsewhere(&mut self, fit: f64) {
        let Some(found) = self.candidates() else { return };
        let score = self.bench.best(found.places());
        let there = self.usual.relative(self.bench.hit_share(score));
        if there < fit + BETTER {
            return;
        }
        if self.others.len() == OTHERS {
            let log = |nth: &usize| self.others[*nth].odds.log();
            let worst = (0..OTHERS).min_by(|a, b| log(a).total_cmp(&log(b)));
            self.others.remove(worst.unwrap_or_default());
        }
        let count = 4 * self.bench.parameters.min_particles;
        let other = Track::about(&found, count, Odds::chosen(), &mut self.bench);
        self.others.push(other);
    }

    /// Replaces all particles by places that fit the scan.
    fn scatter(&mut self) {
        let Some(found) = self.candidates() else { return };
        let count = self.bench.parameters.max_particles.min(10 * self.bench.parameters.min_particles);
        self.followed = Track::about(&found, count, Odds::even(), &mut self.bench);
    }

    fn candidates(&mut self) -> Option<Candidates> {
        let Bench { field, beams, random, .. } = &mut self.bench;
        Candidates::find(field, &beams.some(CANDIDATE_BEAMS), random)
    }
}

fn valid(pose: Pose2) -> Result<(), LocalizationError> {
    if pose.is_valid() { Ok(()) } else { Err(LocalizationError::NoPose(pose)) }
}

/// Divides the lengths of a covariance by `unit`.
fn in_cells(covariance: &[f64; 9], unit: f64) -> [f64; 9] {
    let scale = [unit.recip(), unit.recip(), 1.0];
    std::array::from_fn(|i| covariance[i] * scale[i / 3] * scale[i % 3])
}
