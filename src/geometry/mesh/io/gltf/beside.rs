//! Buffers in files beside a `.gltf`.
//!
//! Purpose: [`taken_in`] puts the files that a `.gltf` names into its text, so that all readers and servers take it.
//! Invariant: no file is read that is not in the folder of the `.gltf`, or below it. Must not know: what is in buffers.

use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::document::{Document, Text};
use crate::mesh::io::DataError;
use crate::mesh::io::numbers::plain;

/// The text of a `.gltf` with the data of the buffers that accessors need. Other documents stay as they are.
pub(in crate::mesh::io) fn taken_in<'a>(json: &'a [u8], folder: &Path) -> Result<Cow<'a, [u8]>, DataError> {
    // What is wrong with it is said by the reader.
    let Ok(document) = Document::read(json) else { return Ok(json.into()) };
    let mut needed: Vec<u32> = document.needed_buffers().collect();
    needed.sort_unstable();
    needed.dedup();
    let mut names = Vec::new();
    for index in needed {
        let buffer = document.buffers.get(index as usize).and_then(|buffer| buffer.uri.as_ref());
        let Some(Text(uri)) = buffer.filter(|Text(uri)| !uri.starts_with("data:")) else { continue };
        let wrong = |message: &str| DataError::Element {
            element: "buffer",
            index: index as usize,
            message: format!("its data are in {:?}, {message}", plain(uri, 60)),
        };
        let Cow::Borrowed(text) = uri else { return Err(wrong("a name with escapes; export it as .glb")) };
        let path = within(text).ok_or_else(|| wrong("which is no file in its folder; put it there"))?;
        let data = read(folder, &path).map_err(|cause| wrong(&format!("which cannot be read: {cause}")))?;
        let begin = text.as_ptr().addr() - json.as_ptr().addr();
        names.push((begin, begin + text.len(), data));
    }
    if names.is_empty() {
        return Ok(json.into());
    }
    names.sort_unstable_by_key(|&(begin, ..)| begin);
    let more: usize = names.iter().map(|(.., data)| data.len() / 3 * 4 + 64).sum();
    let mut text = String::with_capacity(json.len() + more);
    let mut passed = 0;
    let utf8 = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    for (begin, end, data) in names {
        text.push_str(&utf8(&json[passed..begin]));
        text.push_str("data:application/octet-stream;base64,");
        STANDARD.encode_string(data, &mut text);
        passed = end;
    }
    text.push_str(&utf8(&json[passed..]));
    Ok(text.into_bytes().into())
}

/// A relative path that leads nowhere but down, with its escapes (`%20`) undone.
fn within(uri: &str) -> Option<PathBuf> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        bytes.push(match (byte, rest) {
            (b'%', [high, low, after @ ..]) => {
                rest = after;
                let digit = |digit: u8| char::from(digit).to_digit(16);
                (digit(*high)? << 4 | digit(*low)?) as u8
            }
            _ => byte,
        });
    }
    let name = String::from_utf8(bytes).ok().filter(|name| !name.contains(['\\', ':', '\0']))?;
    let path = PathBuf::from(name);
    let is_down = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    (path.file_name().is_some() && path.components().all(is_down)).then_some(path)
}

/// Links may not lead out of the folder either.
fn read(folder: &Path, path: &Path) -> std::io::Result<Vec<u8>> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let whole = folder.join(path).canonicalize()?;
    if !whole.starts_with(folder.canonicalize()?) || !whole.is_file() {
        return Err(std::io::Error::new(std::io::ErrorKind::NotFound, "it is no file in the folder"));
    }
    std::fs::read(whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_down_alone() {
        for (uri, path) in [("a.bin", "a.bin"), ("./b/a%20b.bin", "./b/a b.bin"), ("%C3%A4.bin", "ä.bin")] {
            assert_eq!(within(uri), Some(PathBuf::from(path)));
        }
        for uri in [
            "",
            ".",
            "..",
            "../a.bin",
            "b/../../a.bin",
            "%2e%2e/a.bin",
            "/etc/passwd",
            "http://a/b",
            "C:\\a",
            "c:a",
            "%zz",
            "%ff",
            "a%00",
        ] {
            assert_eq!(within(uri), None, "{uri}");
        }
    }
}
