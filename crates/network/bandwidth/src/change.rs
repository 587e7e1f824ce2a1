//! Changes of allocations, as instructions for their paths.

use cotorra_graph::Instruction;

use crate::allocation::{Allocation, Path};

/// A change of one allocation, which is not in force yet.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    pub(crate) id: u64,
    pub(crate) after: Option<Allocation>,
    steps: Vec<Step>,
}

#[derive(Debug, Clone, PartialEq)]
struct Step {
    before: Option<Path>,
    after: Option<Path>,
}

impl Change {
    /// Returns the change from some paths to those of an allocation. Paths that go come first.
    pub(crate) fn new(id: u64, before: &[Path], after: Allocation) -> Self {
        let same = |a: &Path, among: &[Path]| among.iter().find(|b| b.ends == a.ends).cloned();
        let gone = before.iter().filter(|path| same(path, &after.paths).is_none());
        let gone = gone.map(|path| Step { before: Some(path.clone()), after: None });
        let kept =
            after.paths.iter().map(|path| Step { before: same(path, before), after: Some(path.clone()) });
        let steps = gone.chain(kept).filter(|step| step.before != step.after).collect();
        Self { id, after: Some(after), steps }
    }

    /// Returns the end of an allocation with these paths.
    pub(crate) fn end<'a>(id: u64, paths: impl Iterator<Item = &'a Path>) -> Self {
        let steps = paths.map(|path| Step { before: Some(path.clone()), after: None }).collect();
        Self { id, after: None, steps }
    }

    /// Returns instructions that bring it about, in order. If one is rejected, [`Self::undo`] has those that take back the ones
    /// before it.
    pub fn instructions(&self) -> impl Iterator<Item = Instruction> {
        self.steps.iter().filter_map(|step| Step::instruction(&step.before, &step.after))
    }

    /// Returns the instructions that take back the first so many.
    pub fn undo(&self, done: usize) -> impl Iterator<Item = Instruction> {
        let done = &self.steps[..done.min(self.steps.len())];
        done.iter().rev().filter_map(|step| Step::instruction(&step.after, &step.before))
    }
}

impl Step {
    fn instruction(from: &Option<Path>, to: &Option<Path>) -> Option<Instruction> {
        to.as_ref().map(Path::map).or_else(|| from.as_ref().map(Path::unmap))
    }
}
