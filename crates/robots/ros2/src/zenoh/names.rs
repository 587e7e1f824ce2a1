//! What `rmw_zenoh` calls things in Zenoh: topics, and the tokens that say what there is in the ROS graph.

use crate::{carried::Kind, names::Names, peers::Endpoint, qos::Qos};

/// Where tokens are.
const TOKENS: &str = "@ros2_lv";
/// Stands for `/`, and for what is empty.
const SLASH: &str = "%";

/// The key expression of a topic as a type: what it carries goes there.
pub fn topic_key(domain: u16, topic: &str, kind: &Kind) -> String {
    format!("{domain}/{}/{}/{}", topic.trim_matches('/'), kind.dds_name, kind.hash)
}

/// The key expression of all tokens of a domain.
pub fn all_tokens(domain: u16) -> String {
    format!("{TOKENS}/{domain}/**")
}

/// What a token tells of.
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

/// Who says a token: a node, which has a session to itself.
pub struct Speaker<'a> {
    pub domain: u16,
    /// Of Zenoh's.
    pub session: &'a str,
    pub names: &'a Names,
}

impl Speaker<'_> {
    /// The node's own token.
    pub fn node(&self) -> String {
        self.token(0, Role::Node)
    }

    /// The token of a publisher or subscriber with that number, of which a session has no two.
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
        // Of the session's nodes, this is number 0; it is in no security enclave.
        format!("{TOKENS}/{domain}/{session}/0/{number}/{role}/{SLASH}/{namespace}/{}", names.name())
    }
}

/// Reliability, durability, history and depth, by their numbers in `rmw/types.h`; deadline, lifespan and liveliness are
/// left out, which says that there are none.
fn qos_word(qos: Qos) -> String {
    let (reliability, durability) = (if qos.reliable { 1 } else { 2 }, if qos.latched { 1 } else { 2 });
    format!("{reliability}:{durability}:1,{}:,:,:,,", qos.depth())
}

/// What a token tells of a publisher or subscriber: its session, which of both it is, and the rest. None if it is a node,
/// has to do with services, or is no token.
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
    fn topics_and_tokens_are_called_as_the_design_says() {
        let kind = Kind::of::<Text>();
        assert_eq!(
            topic_key(2, "/tb2/chatter", &kind),
            format!("2/tb2/chatter/std_msgs::msg::dds_::String_/{HASH}")
        );
        let names = Names::new("talker", "/tb2", []).unwrap();
        let speaker = Speaker { domain: 2, session: "aac3", names: &names };
        assert_eq!(speaker.node(), "@ros2_lv/2/aac3/0/0/NN/%/%tb2/talker");
        let token = speaker.endpoint(1, Role::Publisher, "/tb2/chatter", &kind, Qos::LATCHED);
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
        let speaker = Speaker { names: &root, ..speaker };
        assert_eq!(speaker.node(), "@ros2_lv/2/aac3/0/0/NN/%/%/talker");
        let token = speaker.endpoint(2, Role::Subscriber, "/scan", &kind, Qos::SENSORS);
        assert!(token.contains("/MS/%/%/talker/%scan/") && token.ends_with("/2:2:1,5:,:,:,,"), "{token}");
    }

    #[test]
    fn what_is_no_endpoint_is_left_out() {
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
