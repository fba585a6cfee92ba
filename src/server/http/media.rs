//! Formats of surfaces as HTTP names them.
//!
//! Purpose: the format of a media type and of a name; and back. Invariant: all of it comes from [`Format`].
//! Must not know: how a format is read.

use geometry::mesh::io::Format;

pub(super) fn media_type(format: Format) -> &'static str {
    format.media_types().first().copied().unwrap_or("application/octet-stream")
}

/// All names, for a message.
pub(super) fn names() -> String {
    Format::ALL.map(Format::extension).join(", ")
}

/// The format that the first of these media types means, if one does.
pub(super) fn of_types(header: &str) -> Option<Format> {
    header.split(',').find_map(|one| {
        let media = one.split(';').next().unwrap_or_default().trim();
        Format::ALL.into_iter().find(|format| format.media_types().iter().any(|t| t.eq_ignore_ascii_case(media)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_types_of_its_own() {
        for format in Format::ALL {
            assert!(!format.media_types().is_empty());
            assert!(format.media_types().iter().all(|media| of_types(media) == Some(format)));
        }
        assert_eq!(of_types("text/html, model/obj;q=0.9"), Some(Format::Obj));
        assert_eq!(of_types("*/*"), None);
    }
}
