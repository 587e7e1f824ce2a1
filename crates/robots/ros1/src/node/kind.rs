//! The types of topics, by which peers are matched.

use cotorra_ros_messages::Message;

/// A message's type, as connection headers and the master name it.
#[derive(Debug)]
pub(super) struct Kind {
    pub name: &'static str,
    pub md5sum: String,
    pub definition: String,
}

impl Kind {
    /// The type `M`.
    pub fn of<M: Message>() -> Self {
        let description = M::description();
        Self { name: M::ROS1_NAME, md5sum: description.md5sum(), definition: description.ros1_text() }
    }

    /// Checks that a peer's header names this type. `*` stands for any type, and so does an absent name: only the sum
    /// matters.
    pub fn check(&self, md5sum: Option<&str>, name: Option<&str>) -> Result<(), String> {
        let same = |theirs: &str, ours: &str| theirs == "*" || theirs == ours;
        let md5sum = md5sum.ok_or_else(|| "the connection header has no md5sum".to_owned())?;
        if same(md5sum, &self.md5sum) && same(name.unwrap_or("*"), self.name) {
            return Ok(());
        }
        let name = name.unwrap_or("an unnamed type");
        Err(format!("{name} with md5sum {md5sum} where {} with {} is spoken", self.name, self.md5sum))
    }
}
