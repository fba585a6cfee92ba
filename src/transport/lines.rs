//! Lines of HTTP/1.1: those that end by a line feed alone.
//!
//! Purpose: [`Lines`] follows the bytes of a connection and finds such a line in a head, before a chunk or in a trailer. A
//! recipient may take it for the end of a line (RFC 9112, section 2.2), and one that a proxy before it does not: then both see
//! other requests. Invariant: bodies are skipped, whatever they hold. Must not know: what a request asks for.

/// Bytes of a line that are kept: as many as a length or a coding needs.
const KEPT: usize = 128;

#[derive(Debug, Default)]
enum At {
    #[default]
    Head,
    /// Bytes of a body, or of a chunk and its end, that are still to come.
    Body(u64),
    Chunk(u64),
    Size,
    Trailer,
}

/// See the module's head.
#[derive(Debug, Default)]
pub(super) struct Lines {
    at: At,
    line: Vec<u8>,
    last: u8,
    length: u64,
    is_chunked: bool,
}

impl Lines {
    /// Whether all lines that end in `bytes` end as they should.
    pub(super) fn are_whole(&mut self, mut bytes: &[u8]) -> bool {
        while let Some((&byte, rest)) = bytes.split_first() {
            if let At::Body(left) | At::Chunk(left) = &mut self.at {
                let skipped = usize::try_from(*left).unwrap_or(usize::MAX).min(bytes.len());
                *left -= skipped as u64;
                bytes = &bytes[skipped..];
                if *left == 0 {
                    self.at = if matches!(self.at, At::Chunk(_)) { At::Size } else { At::Head };
                }
                continue;
            }
            bytes = rest;
            let before = std::mem::replace(&mut self.last, byte);
            if byte != b'\n' {
                if self.line.len() < KEPT {
                    self.line.push(byte);
                }
                continue;
            }
            if before != b'\r' {
                return false;
            }
            self.ended();
        }
        true
    }

    /// A line has ended.
    fn ended(&mut self) {
        let line = std::mem::take(&mut self.line);
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end_matches('\r');
        match self.at {
            At::Head if text.is_empty() => {
                let length = std::mem::take(&mut self.length);
                self.at = match (std::mem::take(&mut self.is_chunked), length) {
                    (true, _) => At::Size,
                    (false, 0) => At::Head,
                    (false, length) => At::Body(length),
                };
            }
            At::Head => {
                let Some((name, value)) = text.split_once(':') else { return };
                if name.eq_ignore_ascii_case("content-length") {
                    self.length = value.trim().parse().unwrap_or(0);
                } else if name.eq_ignore_ascii_case("transfer-encoding") {
                    self.is_chunked |= value.to_ascii_lowercase().contains("chunked");
                }
            }
            At::Size => {
                let size = text.split(';').next().unwrap_or_default().trim();
                self.at = match u64::from_str_radix(size, 16) {
                    Ok(size) if size > 0 => At::Chunk(size.saturating_add(2)),
                    // The last one, or none: then the connection ends.
                    _ => At::Trailer,
                };
            }
            At::Trailer if text.is_empty() => self.at = At::Head,
            At::Trailer | At::Body(_) | At::Chunk(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: [&str; 4] = [
        "GET / HTTP/1.1\r\nHost: a\r\n\r\n",
        "POST / HTTP/1.1\r\ncontent-LENGTH: 5\r\n\r\na\nb\n\n",
        "\r\nPOST / HTTP/1.1\r\nTransfer-Encoding: gzip, Chunked\r\n\r\n3;x=y\r\n\n\n\n\r\nA\r\n\n\r\n0123456\r\n0\r\nend: x\r\n\r\n",
        "POST / HTTP/1.1\r\nContent-Length: 0\r\n\r\n",
    ];

    #[test]
    fn bodies_may_hold_anything() {
        let all = GOOD.concat().repeat(3);
        for step in 1..all.len() {
            let mut lines = Lines::default();
            assert!(all.as_bytes().chunks(step).all(|piece| lines.are_whole(piece)), "{step}");
            assert!(matches!(lines.at, At::Head), "{step}");
        }
    }

    #[test]
    fn a_line_feed_alone_is_found_wherever_it_ends_a_line() {
        let chunked = "POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\nend: x\r\n\r\n";
        for whole in [GOOD[0], GOOD[3], chunked] {
            for (end, _) in whole.match_indices("\r\n") {
                // The end of a chunk's data belongs to the data.
                if whole[..end].ends_with("abc") {
                    continue;
                }
                let bad = [GOOD[1], &whole[..end], &whole[end + 1..]].concat();
                assert!(!Lines::default().are_whole(bad.as_bytes()), "{bad:?}");
            }
        }
    }
}
