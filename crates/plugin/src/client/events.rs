//! The stream of events: server-sent events (WHATWG HTML, 9.2), each with a `Stamped` as its data.

use std::io::{self, BufRead, BufReader, Read};

use cotorra_graph::{Stamped, Timestamp};

use super::{Client, ClientError};

/// Events of a run as they happen: an iterator that blocks until the next event, and ends with the run.
pub struct Events {
    client: Client,
    url: String,
    lines: BufReader<Box<dyn Read + Send>>,
    line: Vec<u8>,
    missed: u64,
}

/// Message of a stream.
#[derive(Debug)]
pub(super) enum StreamMessage {
    Event(Box<Stamped>),
    /// End of the events so far. Virtual time stands still until the mark is acknowledged.
    Mark {
        number: u64,
        now: Timestamp,
    },
}

/// One server-sent event.
#[derive(Debug, Default, PartialEq)]
struct Message {
    name: String,
    id: String,
    data: String,
}

impl Events {
    pub(super) fn new(client: Client, url: String, stream: impl Read + Send + 'static) -> Self {
        Self { client, url, lines: BufReader::new(Box::new(stream)), line: Vec::new(), missed: 0 }
    }

    /// Returns the number of events that this reader was too slow for.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// The next message with data; `None` at the end of the stream.
    fn message(&mut self) -> io::Result<Option<Message>> {
        let mut message = Message::default();
        let mut has_data = false;
        loop {
            self.line.clear();
            if self.lines.read_until(b'\n', &mut self.line)? == 0 {
                // An unfinished event is void.
                return Ok(None);
            }
            let line = String::from_utf8_lossy(&self.line);
            let line = line.trim_end_matches(['\n', '\r']);
            if line.is_empty() {
                if has_data {
                    return Ok(Some(message));
                }
                message = Message::default();
                continue;
            }
            let (field, value) = line.split_once(':').unwrap_or((line, ""));
            let value = value.strip_prefix(' ').unwrap_or(value);
            match field {
                "data" if has_data => message.data.extend(["\n", value]),
                "data" => {
                    message.data.push_str(value);
                    has_data = true;
                }
                "event" => value.clone_into(&mut message.name),
                "id" => value.clone_into(&mut message.id),
                // Comments, which keep the connection alive, and fields of no meaning here.
                _ => {}
            }
        }
    }
}

impl Events {
    /// Returns the next message; `None` at the end of the stream.
    pub(super) fn next_message(&mut self) -> Option<Result<StreamMessage, ClientError>> {
        loop {
            // A testbed that ends closes all connections: a stream that breaks off has ended, too.
            let message = self.message().ok()??;
            let malformed = |reason: String| ClientError::Malformed { url: self.url.clone(), reason };
            return Some(match message.name.as_str() {
                "missed" => {
                    self.missed += message.data.trim().parse().unwrap_or(1);
                    continue;
                }
                "mark" => match (message.id.parse(), message.data.parse()) {
                    (Ok(number), Ok(now)) => {
                        Ok(StreamMessage::Mark { number, now: Timestamp::from_nanos(now) })
                    }
                    _ => Err(malformed(format!("a mark `{}` at `{}`", message.id, message.data))),
                },
                _ => serde_json::from_str(&message.data)
                    .map(StreamMessage::Event)
                    .map_err(|e| malformed(e.to_string())),
            });
        }
    }
}

impl Iterator for Events {
    type Item = Result<Stamped, ClientError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            return Some(match self.next_message()? {
                Ok(StreamMessage::Event(event)) => Ok(*event),
                // All events before it were asked for, and so is the next: those before were taken in.
                Ok(StreamMessage::Mark { number, .. }) => match self.client.done(number, None) {
                    Ok(()) => continue,
                    Err(error) if error.is_end() => return None,
                    Err(error) => Err(error),
                },
                Err(error) => Err(error),
            });
        }
    }
}

impl std::fmt::Debug for Events {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Events").field("url", &self.url).field("missed", &self.missed).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Event, Timestamp};
    use proptest::prelude::*;

    use super::*;

    fn read(stream: &str) -> Events {
        let client = Client::new("http://test").unwrap();
        Events::new(
            client,
            "http://test/api/v1/events".to_owned(),
            io::Cursor::new(stream.as_bytes().to_vec()),
        )
    }

    fn notices(stream: &str) -> Vec<(u64, String)> {
        let notice = |stamped: Result<Stamped, ClientError>| match stamped.unwrap() {
            Stamped { at, event: Event::Notice { message } } => (at.as_nanos(), message),
            other => panic!("not a notice: {other:?}"),
        };
        read(stream).map(notice).collect()
    }

    #[test]
    fn reads_each_event_with_its_time() {
        let stream = "data: {\"at_ns\": 5, \"event\": \"notice\", \"message\": \"a\"}\n\n\
                      data:{\"at_ns\": 6, \"event\": \"notice\", \"message\": \"b\"}\r\n\r\n";
        assert_eq!(notices(stream), [(5, "a".to_owned()), (6, "b".to_owned())]);
    }

    #[test]
    fn skips_comments_and_unknown_fields_and_joins_lines_of_data() {
        let stream = ":\n\n: keep-alive\nid: 7\nretry: 100\nevent: message\n\
                      data: {\"at_ns\": 5,\ndata: \"event\": \"notice\", \"message\": \"a\"}\n\n";
        assert_eq!(notices(stream), [(5, "a".to_owned())]);
    }

    #[test]
    fn missed_events_are_counted() {
        let stream = "event: missed\ndata: 3\n\ndata: {\"at_ns\": 1, \"event\": \"notice\", \"message\": \"a\"}\n\n\
                      event: missed\ndata: 4\n\n";
        let mut events = read(stream);
        assert_eq!(events.next().unwrap().unwrap().at, Timestamp::from_nanos(1));
        assert_eq!(events.missed(), 3);
        assert!(events.next().is_none());
        assert_eq!(events.missed(), 7);
    }

    #[test]
    fn truncated_events_are_dropped() {
        assert_eq!(notices("data: {\"at_ns\": 5, \"event\": \"notice\", \"message\": \"a\"}\n"), []);
    }

    #[test]
    fn unknown_events_are_errors_and_the_next_is_read() {
        let mut events = read(
            "data: {\"at_ns\": 5, \"event\": \"miracle\"}\n\ndata: {\"at_ns\": 6, \"event\": \"notice\", \"message\": \"\"}\n\n",
        );
        let error = events.next().unwrap().unwrap_err().to_string();
        assert!(error.contains("/api/v1/events") && error.contains("miracle"), "{error}");
        assert!(events.next().unwrap().is_ok());
    }

    proptest! {
        #[test]
        fn no_stream_panics(bytes in prop::collection::vec(any::<u8>(), 0..400), text in "(data|event|id)?:? ?\\PC{0,9}\n{0,2}") {
            let mut stream = bytes;
            stream.extend_from_slice(text.as_bytes());
            read(&String::from_utf8_lossy(&stream)).for_each(drop);
        }
    }
}
