//! `rmw_zenoh`'s names in Zenoh: key expressions of topics, and liveliness tokens of the ROS graph.

use crate::{carried::Kind, names::Names, peers::Endpoint, qos::Qos};

/// Prefix of tokens.
const TOKENS: &str = "@ros2_lv";
/// Stands for `/`, and for empty text.
const SLASH: &str = "%";

/// Returns the key expression of the messages of a topic with a type.
pub fn topic_key(domain: u16, topic: &str, kind: &Kind) -> String {
    format!("{domain}/{}/{}/{}", topic.trim_matches('/'), kind.dds_name, kind.hash)
}

/// Returns the key expression of all tokens of a domain.
pub fn all_tokens(domain: u16) -> String {
    format!("{TOKENS}/{domain}/**")
}

/// Kind of entity that a token announces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Node,
    Publisher,
    Subscriber,
}

impl Role {
    fn word(self) -> &'static str {
        match self {
            Self::Node => "NN",
            Self::Publisher => "MP",
            Self::Subscriber => "MS",
        }
    }
}

/// The owner of a token: a node, which has a session of its own.
pub struct TokenOwner<'a> {
    pub domain: u16,
    /// Identifier of the Zenoh session.
    pub session: &'a str,
    pub names: &'a Names,
}

impl TokenOwner<'_> {
    /// Returns the node's own token.
    pub fn node(&self) -> String {
        self.token(0, Role::Node)
    }

    /// Returns the token of a publisher or subscriber. Its number is unique in the session.
    pub fn endpoint(&self, number: usize, role: Role, topic: &str, kind: &Kind, qos: Qos) -> String {
        let topic = topic.replace('/', SLASH);
        format!(
            "{}/{topic}/{}/{}/{}",
            self.token(number, role),
            kind.dds_name.replace('/', SLASH),
            kind.hash,
            qos_word(qos)
        )
    }

    fn token(&self, number: usize, role: Role) -> String {
        let Self { domain, session, names } = self;
        let (role, namespace) = (role.word(), names.namespace().replace('/', SLASH));
        // The node has number 0 in its session, and no security enclave.
        format!("{TOKENS}/{domain}/{session}/0/{number}/{role}/{SLASH}/{namespace}/{}", names.name())
    }
}

/// Encodes reliability, durability, history and depth by their numbers in `rmw/types.h`. Deadline, lifespan and
/// liveliness are left out: there are none.
fn qos_word(qos: Qos) -> String {
    let (reliability, durability) = (if qos.reliable { 1 } else { 2 }, if qos.latched { 1 } else { 2 });
    format!("{reliability}:{durability}:1,{}:,:,:,,", qos.depth())
}

/// Reads the token of a publisher or subscriber: its session, role and endpoint. Returns `None` for nodes, services and
/// other keys.
pub fn read_token(token: &str) -> Option<(&str, Role, Endpoint)> {
    let parts: Vec<_> = token.split('/').collect();
    let [TOKENS, _domain, session, _node, _number, role, _enclave, _namespace, _name, topic, kind, hash, ..] =
        parts[..]
    else {
        return None;
    };
    let role = [Role::Publisher, Role::Subscriber].into_iter().find(|known| known.word() == role)?;
    let endpoint = Endpoint {
        topic: topic.replace(SLASH, "/"),
        kind: kind.replace(SLASH, "/"),
        hash: Some(hash.to_owned()),
    };
    Some((session, role, endpoint))
}

#[cfg(test)]
mod tests {
    use cotorra_ros_messages::Text;
    use proptest::prelude::*;

    use super::*;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    #[test]
    fn topics_and_tokens_are_named_as_specified() {
        let kind = Kind::of::<Text>();
        assert_eq!(
            topic_key(2, "/tb2/chatter", &kind),
            format!("2/tb2/chatter/std_msgs::msg::dds_::String_/{HASH}")
        );
        let names = Names::new("talker", "/tb2", []).unwrap();
        let owner = TokenOwner { domain: 2, session: "aac3", names: &names };
        assert_eq!(owner.node(), "@ros2_lv/2/aac3/0/0/NN/%/%tb2/talker");
        let token = owner.endpoint(1, Role::Publisher, "/tb2/chatter", &kind, Qos::LATCHED);
        let expected = format!(
            "@ros2_lv/2/aac3/0/1/MP/%/%tb2/talker/%tb2%chatter/std_msgs::msg::dds_::String_/{HASH}/1:1:1,1:,:,:,,"
        );
        assert_eq!(token, expected);
        let endpoint = Endpoint {
            topic: "/tb2/chatter".to_owned(),
            kind: kind.dds_name.clone(),
            hash: Some(HASH.to_owned()),
        };
        assert_eq!(read_token(&token), Some(("aac3", Role::Publisher, endpoint)));
        let root = Names::new("talker", "/", []).unwrap();
        let owner = TokenOwner { names: &root, ..owner };
        assert_eq!(owner.node(), "@ros2_lv/2/aac3/0/0/NN/%/%/talker");
        let token = owner.endpoint(2, Role::Subscriber, "/scan", &kind, Qos::SENSORS);
        assert!(token.contains("/MS/%/%/talker/%scan/") && token.ends_with("/2:2:1,5:,:,:,,"), "{token}");
    }

    #[test]
    fn tokens_of_other_things_are_ignored() {
        for token in [
            "@ros2_lv/2/aac3/0/0/NN/%/%/talker",
            "@ros2_lv/2/aac3/0/1/SS/%/%/talker/%add/a::srv::dds_::B_/RIHS01_0/:,:,:,,",
            "2/chatter/std_msgs::msg::dds_::String_/RIHS01_0",
            "",
        ] {
            assert_eq!(read_token(token), None, "{token}");
        }
    }

    proptest! {
        #[test]
        fn any_token_is_read_or_left_out(token in "(@ros2_lv/)?([a-zMPS@%:/]{0,9}/){0,14}") {
            let _ = read_token(&token);
        }
    }
}
