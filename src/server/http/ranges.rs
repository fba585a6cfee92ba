//! Which bytes of a blob are wanted, and whether they are wanted at all (RFC 9110, sections 13 and 14).
//!
//! Invariant: of several ranges, and of what is no range, all bytes are given, as the RFC allows. Must not know: blobs.

use std::ops::Range;

use axum::http::HeaderMap;
use axum::http::header::{IF_NONE_MATCH, IF_RANGE, RANGE};

/// The range that is wanted of `total` bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    All,
    Part(Range<u64>),
    /// A range that begins after the end.
    Nowhere,
}

/// Whether the client has what has this tag.
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let given = headers.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    given
        .flat_map(|all| all.split(','))
        .map(|one| one.trim().trim_start_matches("W/"))
        .any(|one| one == "*" || one == tag)
}

/// The range that is wanted of a resource with this tag and length.
pub(super) fn wanted(headers: &HeaderMap, tag: &str, size: u64) -> Wanted {
    if headers.get(IF_RANGE).is_some_and(|value| value.as_bytes() != tag.as_bytes()) {
        return Wanted::All;
    }
    headers.get(RANGE).and_then(|value| range(value.to_str().ok()?, size)).unwrap_or(Wanted::All)
}

fn range(text: &str, size: u64) -> Option<Wanted> {
    let (begin, end) = text.strip_prefix("bytes=")?.split_once('-')?;
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let range = match (begin.trim().is_empty(), end.trim().is_empty()) {
        (true, true) => return None,
        // The last bytes.
        (true, false) => size.saturating_sub(number(end)?)..size,
        (false, true) => number(begin)?..size,
        (false, false) => {
            let (begin, end) = (number(begin)?, number(end)?);
            if end < begin {
                return None;
            }
            begin..end.saturating_add(1).min(size)
        }
    };
    Some(if range.start < size && !range.is_empty() { Wanted::Part(range) } else { Wanted::Nowhere })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Wanted {
        let headers = HeaderMap::from_iter([(RANGE, text.parse().unwrap())]);
        wanted(&headers, "\"a\"", 100)
    }

    #[test]
    fn ranges_are_read() {
        for (text, range) in
            [("bytes=0-9", 0..10), ("bytes=90-", 90..100), ("bytes=-5", 95..100), ("bytes=5-999", 5..100)]
        {
            assert_eq!(of(text), Wanted::Part(range), "{text}");
        }
        for text in ["bytes=100-", "bytes=100-200", "bytes=-0"] {
            assert_eq!(of(text), Wanted::Nowhere, "{text}");
        }
        for text in ["", "bytes=", "bytes=-", "bytes=9-0", "bytes=0-1,4-5", "lines=0-1", "bytes=a-b"] {
            assert_eq!(of(text), Wanted::All, "{text}");
        }
    }

    #[test]
    fn a_range_of_something_else_is_all_of_this() {
        let headers =
            |tag: &str| HeaderMap::from_iter([(RANGE, "bytes=0-9".parse().unwrap()), (IF_RANGE, tag.parse().unwrap())]);
        assert_eq!(wanted(&headers("\"a\""), "\"a\"", 100), Wanted::Part(0..10));
        assert_eq!(wanted(&headers("\"b\""), "\"a\"", 100), Wanted::All);
    }

    #[test]
    fn what_is_known_is_not_sent_again() {
        let known = |tags: &str| is_known(&HeaderMap::from_iter([(IF_NONE_MATCH, tags.parse().unwrap())]), "\"a\"");
        assert!(known("\"a\"") && known("\"b\", \"a\"") && known("*") && known("W/\"a\""));
        assert!(!known("\"b\"") && !known("a"));
    }
}
