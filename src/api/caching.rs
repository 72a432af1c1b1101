//! Conditional requests by RFC 9110: entity tags, compared weakly.

use axum::http::{HeaderMap, HeaderName, header};
use axum::response::Response;

use super::status;

/// Cache-Control of a file that is named by the number of its row. The file of a row never changes, but another data folder
/// may be served at the same address later: a client keeps the file and asks each time whether it still has the right one.
pub(super) const ASK_EACH_TIME: &str = "private, no-cache";

/// Entity tag and lifetime of a file, sent with the file and with a 304.
pub(super) struct Caching {
    headers: [(HeaderName, String); 2],
    known: bool,
}

impl Caching {
    /// `tag` is without quotes; `keep` is the value of `Cache-Control`.
    pub fn new(asked: &HeaderMap, tag: &str, keep: &str) -> Caching {
        let etag = format!("\"{tag}\"");
        let lists = asked.get_all(header::IF_NONE_MATCH);
        let known = lists
            .iter()
            .filter_map(|list| list.to_str().ok())
            .flat_map(|list| list.split(','))
            .map(str::trim)
            .any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag);
        Caching {
            headers: [(header::ETAG, etag), (header::CACHE_CONTROL, keep.into())],
            known,
        }
    }

    /// Returns a 304 if the client has the file, which has `bytes` bytes. `Content-Length` is that of the file (RFC 9110,
    /// 8.6); by default axum would send that of the empty answer.
    pub fn not_modified(&self, bytes: u64) -> Option<Response> {
        let length = [(header::CONTENT_LENGTH, bytes)];
        self.known
            .then(|| status::not_modified((self.headers.clone(), length)))
    }

    /// Returns a 304 if the client has the file, whose size is not known: without `Content-Length`, which axum would take from
    /// an empty body.
    pub fn unchanged(&self) -> Option<Response> {
        self.known.then(|| {
            let mut answer = status::not_modified(self.headers.clone());
            let nothing = futures::stream::empty::<Result<Vec<u8>, std::convert::Infallible>>();
            *answer.body_mut() = axum::body::Body::from_stream(nothing);
            answer
        })
    }

    /// Returns the headers of the file.
    pub fn headers(self) -> [(HeaderName, String); 2] {
        self.headers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tag_is_recognised_in_every_form_and_a_304_repeats_it() {
        for (sent, known) in [
            (&["\"a1\""][..], true),
            (&["W/\"a1\""], true),
            (&["*"], true),
            (&["\"b2\", W/\"a1\""], true),
            (&["\"b2\"", "\"a1\""], true),
            (&["\"b2\""], false),
            (&["a1"], false),
            (&[], false),
        ] {
            let mut asked = HeaderMap::new();
            for list in sent {
                asked.append(header::IF_NONE_MATCH, list.parse().unwrap());
            }
            let caching = Caching::new(&asked, "a1", "no-cache");
            let answer = caching.not_modified(7);
            assert_eq!(answer.is_some(), known, "{sent:?}");
            if let Some(answer) = answer {
                assert_eq!(answer.status(), 304);
                assert_eq!(answer.headers()[header::ETAG], "\"a1\"");
                assert_eq!(answer.headers()[header::CACHE_CONTROL], "no-cache");
                assert_eq!(answer.headers()[header::CONTENT_LENGTH], "7");
            }
        }
    }
}
