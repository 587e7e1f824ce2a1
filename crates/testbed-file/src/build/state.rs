//! States of VNFs, which are copied when they move.

use std::time::Duration;

use cotorra_graph::{PreCopy, Program, StateTransfer, TransferMethod};

use super::builder::Builder;
use crate::{
    records::{MigrationWord, StateRecord, VnfRecord},
    yaml::decode::Spanned,
};

/// Default of the longest downtime that a pre-copy aims at, as of QEMU.
const DOWNTIME: Duration = Duration::from_millis(300);
/// Default of the most rounds while the VNF serves.
const ROUNDS: u32 = 30;

impl Builder<'_> {
    /// Builds the state of a VNF, if it has one; `None` for a mistake.
    pub(super) fn state(
        &mut self,
        record: &VnfRecord,
        program: Option<&Program>,
    ) -> Option<Option<Box<StateTransfer>>> {
        let Some(state) = &record.state else { return Some(None) };
        if program == Some(&Program::RobotDriver) || record.pinned_to.is_some() {
            self.sink
                .error(&state.span, "a state of a VNF that never moves")
                .help("leave out `state`, or write `node` in place of `pinned_to`");
            return None;
        }
        let method = match state.value.migration {
            MigrationWord::StopAndCopy => self.stop_and_copy(&state.value),
            MigrationWord::PreCopy => self.pre_copy(state).map(TransferMethod::PreCopy),
        };
        Some(Some(Box::new(StateTransfer { bytes: state.value.size.0, method: method? })))
    }

    fn stop_and_copy(&mut self, state: &StateRecord) -> Option<TransferMethod> {
        let given = [
            ("dirty_rate", state.dirty_rate.as_ref().map(|key| &key.span)),
            ("downtime", state.downtime.as_ref().map(|key| &key.span)),
            ("rounds", state.rounds.as_ref().map(|key| &key.span)),
        ];
        let mut well = true;
        for (key, span) in given.into_iter().filter_map(|(key, span)| Some((key, span?))) {
            self.sink
                .error(span, format!("`{key}` of a VNF that stops before its state is copied"))
                .help(format!("leave out `{key}`, or write `migration: pre_copy`"));
            well = false;
        }
        well.then_some(TransferMethod::StopAndCopy)
    }

    fn pre_copy(&mut self, Spanned { value: state, span }: &Spanned<StateRecord>) -> Option<PreCopy> {
        let StateRecord { size: _, migration: _, dirty_rate, downtime, rounds } = state;
        if let Some(none) = rounds.as_ref().filter(|rounds| rounds.value == 0) {
            self.sink
                .error(&none.span, "a pre-copy of no rounds")
                .help("write 1 or more, or `migration: stop_and_copy`");
            return None;
        }
        let Some(dirty_rate) = dirty_rate else {
            self.sink
                .error(span, "a pre-copy of a state without a `dirty_rate`")
                .help("write how fast it changes, such as `dirty_rate: 40 Mbit/s`");
            return None;
        };
        Some(PreCopy {
            dirty_rate: dirty_rate.value,
            downtime: downtime.as_ref().map_or(DOWNTIME, |downtime| downtime.value),
            rounds: rounds.as_ref().map_or(ROUNDS, |rounds| rounds.value),
        })
    }
}
