//! A testbed for tests: where its applications are, at a time that the test sets.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{NodeId, Nodes, Placement, Testbed, Timestamp, VnfId};
use cotorra_mec::{Dispatch, Epoch, Machine, Outcome};
use serde_json::Value;

use crate::{Applications, Site};

pub(crate) const EPOCH: Epoch = Epoch { unix_ns: 1_000_000_000_000 };

/// The applications of the testbed, and the current time.
pub(crate) struct World {
    pub(crate) site: Arc<Site>,
    pub(crate) now: f64,
    placements: BTreeMap<VnfId, Placement>,
    wanted: BTreeMap<VnfId, Nodes>,
}

fn vnf(name: &str) -> VnfId {
    VnfId::new(name).unwrap()
}

fn node(name: &str) -> Nodes {
    NodeId::new(name).unwrap().into()
}

impl World {
    pub(crate) fn new() -> Self {
        Self::of(&cotorra_graph_testing::applications(["home", "home"]))
    }

    /// Returns a world of a testbed that has these applications, and perhaps more.
    pub(crate) fn of(testbed: &Testbed) -> Self {
        let port = |vnf: &VnfId| (*vnf == *"navigation").then_some(5000);
        let site = Arc::new(Site::new(&testbed.graph, testbed, port));
        let mut world = Self { site, now: 0.0, placements: BTreeMap::new(), wanted: BTreeMap::new() };
        for (name, on) in [("robot-driver", "robot"), ("navigation", "cloud"), ("planner", "edge")] {
            world.serve(name, on);
        }
        world
    }

    /// Has a VNF serve on a node.
    pub(crate) fn serve(&mut self, name: &str, on: &str) {
        self.placements.insert(vnf(name), Placement { vnf: vnf(name), node: node(on) });
    }

    /// Accepts a `place`.
    pub(crate) fn place(&mut self, name: &str, on: &str) {
        self.wanted.insert(vnf(name), node(on));
    }

    pub(crate) fn remove(&mut self, name: &str) {
        self.placements.remove(&vnf(name));
        self.wanted.remove(&vnf(name));
    }

    pub(crate) fn at(&self) -> Timestamp {
        Timestamp::from_secs_f64(self.now)
    }

    pub(crate) fn survey(&self) -> Applications {
        self.site.survey(self.at(), &self.placements, &self.wanted, &BTreeMap::new())
    }

    /// Shows the applications to a machine, and returns the notifications that it sends. All are delivered.
    pub(crate) fn sent<M: Machine<Survey = Applications>>(&self, machine: &mut M) -> Vec<Value> {
        machine.observe(self.survey());
        let mut sent = Vec::new();
        loop {
            let dispatches = machine.poll(self.at());
            if dispatches.is_empty() {
                return sent;
            }
            for Dispatch { subscription, attempt, body, .. } in dispatches {
                sent.push(serde_json::from_str(&body).unwrap());
                machine.subscriptions().done(self.at(), subscription, attempt, Outcome::Delivered);
            }
        }
    }
}
