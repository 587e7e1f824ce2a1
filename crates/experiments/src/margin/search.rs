//! One search: a bisection, or the test of a radio unit that is down.

use cotorra_graph::NodeId;
use cotorra_testbed::Void;

use super::{
    bisection::{Bisection, Grid},
    change::{Change, Dimension, Kind, LOSS_UNITS},
    finding::{Finding, ServiceKept},
};

/// One search.
pub(super) struct Search {
    pub(super) dimension: Option<Dimension>,
    pub(super) down: Option<NodeId>,
    bisection: Bisection,
    /// The verdict at the smallest amount that broke the target so far.
    pub(super) broken: Option<Verdict>,
    /// The reason for which a run was void, which ends the search.
    pub(super) void: Option<Void>,
}

impl Search {
    pub(super) fn new(dimension: Option<Dimension>, down: Option<NodeId>, grid: Grid) -> Self {
        Self { dimension, down, bisection: Bisection::new(grid), broken: None, void: None }
    }

    /// Returns the next change to test; `None` at the end.
    pub(super) fn next(&self) -> Option<Change> {
        if self.void.is_some() {
            return None;
        }
        let amount = self.bisection.next()?;
        let worse = self.dimension.clone().map(|dimension| (dimension, amount));
        Some(Change { worse, down: self.down.clone() })
    }

    pub(super) fn learn(&mut self, verdict: Verdict) {
        self.bisection.learn(verdict.breaks);
        if verdict.breaks {
            self.broken = Some(verdict);
        }
    }

    pub(super) fn finding(&self) -> Finding {
        let is_void = self.void.is_some();
        let first = self.broken.as_ref().and_then(|verdict| verdict.first.clone());
        let first = first.filter(|_| !is_void);
        let (service, kept, failed) =
            first.map_or((None, None, None), |its| (Some(its.service), its.kept, its.failed));
        let survives = self.bisection.survived() as f64;
        let breaks = self.bisection.broke().map(|amount| amount as f64);
        let (none, in_ms) = ([None; 2], || [Some(survives / 1e6), breaks.map(|breaks| breaks / 1e6)]);
        let units = LOSS_UNITS as f64;
        let in_share = || [Some(survives / units), breaks.map(|breaks| breaks / units)];
        let kind = self.dimension.as_ref().map_or(Kind::Down, Dimension::kind);
        let ([survives_ms, breaks_ms], [survives_loss, breaks_loss]) = match kind {
            _ if is_void => (none, none),
            Kind::Down => (none, none),
            Kind::Loss => (none, in_share()),
            Kind::Delay | Kind::Answers => (in_ms(), none),
        };
        Finding {
            change: kind.name(),
            on: self.dimension.as_ref().map(|dimension| dimension.on().to_owned()),
            down: self.down.clone(),
            breaks: breaks.is_some() && !is_void,
            survives_ms,
            breaks_ms,
            survives_loss,
            breaks_loss,
            service,
            kept,
            failed,
            complete: !is_void && self.bisection.next().is_none(),
            void: self.void.clone(),
        }
    }
}

/// Whether a change breaks a target, over all seeds.
pub(super) struct Verdict {
    pub(super) breaks: bool,
    /// The first service whose target is broken.
    pub(super) first: Option<ServiceKept>,
}
