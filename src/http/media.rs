//! Formats of surfaces as HTTP names them.
//!
//! Purpose: the format of a media type, of a name, and of bytes that nobody named; and back. Invariant: a match names every
//! format, so that a new one does not compile until it is here. Must not know: what is in a file beyond its first line.

use crate::job::record::MeshFormat;

/// All formats.
const ALL: [MeshFormat; 4] = [MeshFormat::Ply, MeshFormat::Obj, MeshFormat::Stl, MeshFormat::Off];

/// The media type of a format, and others that mean it.
fn types(format: MeshFormat) -> &'static [&'static str] {
    match format {
        MeshFormat::Ply => &["application/x-ply", "model/ply", "model/x-ply", "application/ply"],
        MeshFormat::Obj => &["model/obj", "application/x-obj", "model/x-obj"],
        MeshFormat::Stl => {
            &["model/stl", "model/x.stl-binary", "model/x.stl-ascii", "application/sla", "application/vnd.ms-pki.stl"]
        }
        MeshFormat::Off => &["application/x-off", "model/off", "model/x-off"],
    }
}

/// What the query calls a format.
pub(super) fn name(format: MeshFormat) -> &'static str {
    match format {
        MeshFormat::Ply => "ply",
        MeshFormat::Obj => "obj",
        MeshFormat::Stl => "stl",
        MeshFormat::Off => "off",
    }
}

/// The media type of a format.
pub(super) fn media_type(format: MeshFormat) -> &'static str {
    types(format).first().copied().unwrap_or("application/octet-stream")
}

/// The format of a name.
pub(super) fn of_name(text: &str) -> Option<MeshFormat> {
    ALL.into_iter().find(|format| name(*format).eq_ignore_ascii_case(text))
}

/// All names, for who gave another.
pub(super) fn names() -> String {
    ALL.map(name).join(", ")
}

/// The format that the first of these media types means, if one does.
pub(super) fn of_types(header: &str) -> Option<MeshFormat> {
    header.split(',').find_map(|one| {
        let media = one.split(';').next().unwrap_or_default().trim();
        ALL.into_iter().find(|format| types(*format).iter().any(|known| known.eq_ignore_ascii_case(media)))
    })
}

/// The format of a file, by its bytes.
pub(super) fn sniffed(bytes: &[u8]) -> Option<MeshFormat> {
    /// Header of a binary STL and its count, and a facet.
    const HEAD: u64 = 84;
    const FACET: u64 = 50;
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        return Some(MeshFormat::Ply);
    }
    let count = bytes.get(80..84).and_then(|count| Some(u64::from(u32::from_le_bytes(count.try_into().ok()?))));
    if count.is_some_and(|count| HEAD + FACET * count == bytes.len() as u64) {
        return Some(MeshFormat::Stl);
    }
    let head = &bytes[..bytes.len().min(64 << 10)];
    let mut lines = head.split(|byte| *byte == b'\n').map(|line| line.trim_ascii());
    let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"))?;
    match first.split(u8::is_ascii_whitespace).next()? {
        b"solid" => Some(MeshFormat::Stl),
        b"OFF" | b"COFF" | b"NOFF" | b"CNOFF" | b"STOFF" => Some(MeshFormat::Off),
        b"v" | b"vn" | b"vt" | b"f" | b"o" | b"g" | b"s" | b"usemtl" | b"mtllib" => Some(MeshFormat::Obj),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_a_type_and_a_name_of_its_own() {
        for format in ALL {
            assert_eq!(of_types(media_type(format)), Some(format));
            assert_eq!(of_name(name(format)), Some(format));
        }
        assert_eq!(of_types("text/html, model/obj;q=0.9"), Some(MeshFormat::Obj));
        assert_eq!(of_types("*/*"), None);
    }

    #[test]
    fn files_say_what_they_are() {
        let mut stl = vec![0; 84];
        stl[80] = 1;
        stl.resize(134, 7);
        for (bytes, format) in [
            (&b"ply\nformat ascii 1.0\n"[..], Some(MeshFormat::Ply)),
            (b"# made by hand\n\nv 0 0 0\n", Some(MeshFormat::Obj)),
            (b"mtllib a.mtl\r\nv 0 0 0\n", Some(MeshFormat::Obj)),
            (b"solid cube\n", Some(MeshFormat::Stl)),
            (&stl, Some(MeshFormat::Stl)),
            (b"OFF\n3 1 0\n", Some(MeshFormat::Off)),
            (b"{}", None),
            (b"", None),
        ] {
            assert_eq!(sniffed(bytes), format);
        }
    }
}
