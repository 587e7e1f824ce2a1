//! Figures of radios outside of the fabric.

use cotorra_graph::{Attachment, NodeId, RadioContext, Timestamp};

/// Completes φ and ι with what kernels report.
pub(crate) trait RadioFigures: Send + Sync {
    /// Completes φ of a robot with such a radio, and leaves all others as they are.
    fn complete_attachments(&self, now: Timestamp, robot: &NodeId, attachments: &mut [Attachment]);

    /// Completes ι of a radio unit with such a radio, and leaves all others as they are.
    fn complete_radio(&self, context: &mut RadioContext);
}
