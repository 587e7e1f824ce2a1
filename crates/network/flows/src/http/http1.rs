//! Parses requests and responses of HTTP/1 on one connection (RFC 9112).

use std::collections::VecDeque;

use self::{body::Body, head::Head};
use super::{MOST, Next, NotHttp, Passed};

mod body;
mod head;

/// A request that waits for its response.
#[derive(Debug)]
struct Pending {
    /// Number on the connection, if it is measured.
    measured: Option<u64>,
    method: Method,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Head,
    Connect,
    Other,
}

/// The parser's position in one direction.
#[derive(Debug)]
enum Place {
    /// Before a message, or in its head.
    Head(Head),
    Body(Body),
}

/// The state of both directions of a connection.
#[derive(Debug)]
pub(super) struct Exchange {
    path: Option<String>,
    client: Place,
    /// Time and mark of the request's first byte.
    began: Option<Passed>,
    server: Place,
    pending: VecDeque<Pending>,
    /// Number of measured requests so far.
    count: u64,
}

impl Exchange {
    pub fn new(path: Option<String>) -> Self {
        let [client, server] = [Place::Head(Head::default()), Place::Head(Head::default())];
        Self { path, client, began: None, server, pending: VecDeque::new(), count: 0 }
    }

    /// Takes the client's next bytes. Passes each measured request to `begin`.
    pub fn client(
        &mut self,
        now: Passed,
        mut bytes: &[u8],
        mut begin: impl FnMut(u64, Passed),
    ) -> Result<(), NotHttp> {
        while !bytes.is_empty() {
            match &mut self.client {
                Place::Body(body) => {
                    let is_over = body.take(&mut bytes)?;
                    if is_over {
                        self.client = Place::Head(Head::default());
                    }
                }
                Place::Head(head) => {
                    let is_whole = head.take(&mut bytes)?;
                    if !head.is_empty() {
                        self.began.get_or_insert(now);
                    }
                    if !is_whole {
                        continue;
                    }
                    let (path, method, body) = request(head.bytes())?;
                    let entered = self.began.take().unwrap_or(now);
                    if self.pending.len() == MOST {
                        return Err(NotHttp);
                    }
                    let is_measured = self.path.as_ref().is_none_or(|wanted| *wanted == path);
                    let measured = is_measured.then_some(self.count);
                    if let Some(number) = measured {
                        begin(number, entered);
                        self.count += 1;
                    }
                    self.pending.push_back(Pending { measured, method });
                    self.client = body.map_or_else(|| Place::Head(Head::default()), Place::Body);
                }
            }
        }
        Ok(())
    }

    /// Takes the server's next bytes. Passes each measured request whose response ends in them to `answer`.
    pub fn server(&mut self, mut bytes: &[u8], mut answer: impl FnMut(u64)) -> Result<Next, NotHttp> {
        while !bytes.is_empty() {
            match &mut self.server {
                Place::Body(body) => {
                    if body.take(&mut bytes)? {
                        self.respond(&mut answer);
                    }
                }
                Place::Head(head) => {
                    if !head.take(&mut bytes)? {
                        continue;
                    }
                    let pending = self.pending.front().ok_or(NotHttp)?;
                    let (status, body) = response(head.bytes(), pending.method)?;
                    let is_another =
                        status == 101 || pending.method == Method::Connect && (200..300).contains(&status);
                    match body {
                        _ if is_another => {
                            self.respond(&mut answer);
                            return Ok(Next::Other);
                        }
                        // The final response is still to come.
                        _ if status < 200 => self.server = Place::Head(Head::default()),
                        None => self.respond(&mut answer),
                        Some(body) => self.server = Place::Body(body),
                    }
                }
            }
        }
        Ok(Next::Http)
    }

    /// Ends the server's direction. Returns the measured request whose response ends with it.
    pub fn close(&mut self) -> Option<u64> {
        let ends = matches!(&self.server, Place::Body(Body::UntilClose));
        ends.then(|| self.end_response()).flatten()
    }

    fn respond(&mut self, answer: &mut impl FnMut(u64)) {
        if let Some(request) = self.end_response() {
            answer(request);
        }
    }

    fn end_response(&mut self) -> Option<u64> {
        self.server = Place::Head(Head::default());
        self.pending.pop_front()?.measured
    }
}

/// Returns path, method and body of a request with this head.
fn request(head: &[u8]) -> Result<(String, Method, Option<Body>), NotHttp> {
    let mut headers = [httparse::EMPTY_HEADER; head::MOST_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    request.parse(head).ok().filter(httparse::Status::is_complete).ok_or(NotHttp)?;
    let target = request.path.ok_or(NotHttp)?;
    // RFC 9112, 3.2.2: a request to a proxy has the absolute URI.
    let path = match target.split_once("://") {
        Some((_, rest)) if !target.starts_with('/') => rest.find('/').map_or("/", |slash| &rest[slash..]),
        _ => target,
    };
    let path = path.split('?').next().unwrap_or_default().to_owned();
    let method = match request.method {
        Some("HEAD") => Method::Head,
        Some("CONNECT") => Method::Connect,
        _ => Method::Other,
    };
    // RFC 9112, 6.3: a request without a length has no body.
    let body = Body::of(request.headers)?.filter(|body| !matches!(body, Body::UntilClose));
    Ok((path, method, body))
}

/// Returns status and body of a response with this head to a request of this method.
fn response(head: &[u8], to: Method) -> Result<(u16, Option<Body>), NotHttp> {
    let mut headers = [httparse::EMPTY_HEADER; head::MOST_HEADERS];
    let mut response = httparse::Response::new(&mut headers);
    response.parse(head).ok().filter(httparse::Status::is_complete).ok_or(NotHttp)?;
    let status = response.code.ok_or(NotHttp)?;
    // RFC 9112, 6.3.
    let has_none = status < 200 || status == 204 || status == 304 || to == Method::Head;
    let body = if has_none { None } else { Body::of(response.headers)? };
    Ok((status, body))
}
