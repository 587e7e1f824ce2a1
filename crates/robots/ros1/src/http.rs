//! The part of HTTP/1.1 that XML-RPC needs, as functions of bytes: `POST` with a length, and its response.
//!
//! Source: RFC 9112.

/// Longest head, bytes.
const MAX_HEAD: usize = 16 << 10;
/// Most fields of a head.
const MAX_FIELDS: usize = 64;

/// Reason why bytes are not an HTTP message that XML-RPC uses.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HttpError {
    /// The bytes are not HTTP.
    #[error("not HTTP: {0}")]
    Syntax(#[from] httparse::Error),
    /// The head is too long.
    #[error("a head is {MAX_HEAD} bytes long at most")]
    LongHead,
    /// The request is not a `POST`.
    #[error("XML-RPC needs POST, not {0}")]
    Method(String),
    /// The length is missing, or not a number.
    #[error("a request needs a Content-Length")]
    NoLength,
    /// The body is longer than the limit.
    #[error("a body of {length} bytes is over the limit of {limit}")]
    LongBody {
        /// Its length.
        length: usize,
        /// The limit.
        limit: usize,
    },
    /// The body has a transfer coding.
    #[error("transfer codings such as `chunked` are not supported")]
    Coding,
    /// The peer answered with an error status.
    #[error("the peer answers with status {0}")]
    Status(u16),
    /// The connection ended within the message.
    #[error("the connection ends within the message")]
    Short,
}

/// A request that arrived in full.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request<'a> {
    /// The body.
    pub body: &'a [u8],
    /// Its length with the head, bytes.
    pub len: usize,
    /// Whether another request may follow on the connection.
    pub keep_alive: bool,
}

struct Fields {
    length: Option<usize>,
    connection: Option<bool>,
}

fn read_fields(fields: &[httparse::Header<'_>], limit: usize) -> Result<Fields, HttpError> {
    let mut read = Fields { length: None, connection: None };
    for field in fields {
        let value = std::str::from_utf8(field.value).unwrap_or_default().trim();
        if field.name.eq_ignore_ascii_case("content-length") {
            let length = value.parse().map_err(|_| HttpError::NoLength)?;
            if length > limit {
                return Err(HttpError::LongBody { length, limit });
            }
            read.length = Some(length);
        } else if field.name.eq_ignore_ascii_case("transfer-encoding") {
            return Err(HttpError::Coding);
        } else if field.name.eq_ignore_ascii_case("connection") {
            read.connection = Some(!value.eq_ignore_ascii_case("close"));
        }
    }
    Ok(read)
}

/// Parses the request at the beginning of `bytes`. Returns `None` if it is incomplete.
///
/// # Errors
/// [`HttpError`]. The connection cannot be used any more.
pub fn parse_request(bytes: &[u8], limit: usize) -> Result<Option<Request<'_>>, HttpError> {
    let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    let httparse::Status::Complete(head) = request.parse(bytes)? else {
        return if bytes.len() > MAX_HEAD { Err(HttpError::LongHead) } else { Ok(None) };
    };
    match request.method {
        Some("POST") => {}
        method => return Err(HttpError::Method(method.unwrap_or_default().to_owned())),
    }
    let http_1_1 = request.version == Some(1);
    let Fields { length, connection } = read_fields(request.headers, limit)?;
    let len = head + length.ok_or(HttpError::NoLength)?;
    let keep_alive = connection.unwrap_or(http_1_1);
    Ok(bytes.get(head..len).map(|body| Request { body, len, keep_alive }))
}

/// Returns the body of the response in `bytes`, or `None` if it is incomplete. `ended` says that no byte follows.
///
/// # Errors
/// [`HttpError`] if it is not a response, or one with an error status.
pub fn parse_response(bytes: &[u8], ended: bool, limit: usize) -> Result<Option<&[u8]>, HttpError> {
    let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
    let mut response = httparse::Response::new(&mut fields);
    let httparse::Status::Complete(head) = response.parse(bytes)? else {
        return match ended {
            _ if bytes.len() > MAX_HEAD => Err(HttpError::LongHead),
            true => Err(HttpError::Short),
            false => Ok(None),
        };
    };
    match response.code {
        Some(200) => {}
        code => return Err(HttpError::Status(code.unwrap_or_default())),
    }
    match read_fields(response.headers, limit)?.length {
        Some(length) => match bytes.get(head..head + length) {
            None if ended => Err(HttpError::Short),
            body => Ok(body),
        },
        // RFC 9112, 6.3: without a length, up to the end.
        None if ended => Ok(bytes.get(head..)),
        None if bytes.len() - head > limit => Err(HttpError::LongBody { length: bytes.len() - head, limit }),
        None => Ok(None),
    }
}

/// Builds a request that posts XML to a host, `name:port`.
pub fn request(host: &str, xml: &str) -> Vec<u8> {
    format!(
        "POST / HTTP/1.1\r\nHost: {host}\r\nUser-Agent: cotorra\r\nConnection: close\r\n\
         Content-Type: text/xml\r\nContent-Length: {}\r\n\r\n{xml}",
        xml.len()
    )
    .into_bytes()
}

/// Builds a response with an XML body.
pub fn response(xml: &str, keep_alive: bool) -> Vec<u8> {
    let connection = if keep_alive { "keep-alive" } else { "close" };
    format!(
        "HTTP/1.1 200 OK\r\nServer: cotorra\r\nConnection: {connection}\r\n\
         Content-Type: text/xml\r\nContent-Length: {}\r\n\r\n{xml}",
        xml.len()
    )
    .into_bytes()
}

/// Builds a response that rejects a request and closes the connection.
pub fn refusal() -> Vec<u8> {
    b"HTTP/1.1 400 Bad Request\r\nServer: cotorra\r\nConnection: close\r\nContent-Length: 0\r\n\r\n".to_vec()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn request_is_parsed_once_complete() {
        let bytes = request("localhost:11311", "<a/>");
        for len in 0..bytes.len() {
            assert_eq!(parse_request(&bytes[..len], 100), Ok(None));
        }
        let mut two = bytes.clone();
        two.extend_from_slice(b"POST");
        let expected = Request { body: b"<a/>", len: bytes.len(), keep_alive: false };
        assert_eq!(parse_request(&two, 100), Ok(Some(expected)));
    }

    #[test]
    fn response_is_parsed_once_complete() {
        let bytes = response("<a/>", true);
        for len in 0..bytes.len() {
            assert_eq!(parse_response(&bytes[..len], false, 100), Ok(None));
            assert!(parse_response(&bytes[..len], true, 100).is_err());
        }
        assert_eq!(parse_response(&bytes, false, 100), Ok(Some(b"<a/>".as_slice())));
        let unending = b"HTTP/1.0 200 OK\r\n\r\n<a/>";
        assert_eq!(parse_response(unending, false, 100), Ok(None));
        assert_eq!(parse_response(unending, true, 100), Ok(Some(b"<a/>".as_slice())));
    }

    #[test]
    fn unsupported_messages_are_rejected() {
        assert_eq!(parse_request(b"GET / HTTP/1.1\r\n\r\n", 9), Err(HttpError::Method("GET".to_owned())));
        assert_eq!(parse_request(b"POST / HTTP/1.1\r\n\r\n", 9), Err(HttpError::NoLength));
        let long = b"POST / HTTP/1.1\r\nContent-Length: 10\r\n\r\n";
        assert_eq!(parse_request(long, 9), Err(HttpError::LongBody { length: 10, limit: 9 }));
        let chunked = b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n";
        assert_eq!(parse_request(chunked, 9), Err(HttpError::Coding));
        assert_eq!(parse_response(&refusal(), false, 9), Err(HttpError::Status(400)));
        let head = [b"POST / HTTP/1.1\r\nA: ".as_slice(), &[b'a'; MAX_HEAD]].concat();
        assert_eq!(parse_request(&head, 9), Err(HttpError::LongHead));
    }

    proptest! {
        #[test]
        fn parsing_never_panics(head in "(POST / HTTP/1.1|HTTP/1.1 200 OK)?\r\n", bytes in any::<Vec<u8>>(), ended: bool) {
            let bytes = [head.as_bytes(), &bytes].concat();
            let _ = (parse_request(&bytes, 50), parse_response(&bytes, ended, 50));
        }
    }
}
