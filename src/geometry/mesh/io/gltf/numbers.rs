//! Numbers of accessors.
//!
//! Purpose: [`Source`] finds the bytes of an accessor, [`Numbers`] reads them where they are. A sparse accessor is made whole first.
//! Invariant: a buffer that no accessor needs is not read, and refuses no file. Numbers count against a bound.
//! Must not know: nodes, meshes.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::HashMap;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::document::{Accessor, Document, Part, Text, View};
use super::repeated;
use crate::mesh::io::DataError;
use crate::mesh::io::numbers::{Kind, numbers, plain};

pub(super) struct Source<'a> {
    pub(super) document: &'a Document<'a>,
    buffers: HashMap<u32, Result<Cow<'a, [u8]>, DataError>>,
    /// Bytes that may still be made of the file's.
    left: Cell<usize>,
}

/// A number of the accessor's type that stands for 1, where numbers are normalized.
fn kind(component_type: u32) -> Option<(Kind, f64)> {
    Some(match component_type {
        5120 => (Kind::I8, 127.0),
        5121 => (Kind::U8, 255.0),
        5122 => (Kind::I16, 32767.0),
        5123 => (Kind::U16, 65535.0),
        5125 => (Kind::U32, 1.0),
        5126 => (Kind::F32, 1.0),
        _ => return None,
    })
}

impl<'a> Source<'a> {
    pub(super) fn of(document: &'a Document<'a>, binary: Option<&'a [u8]>, most: usize) -> Self {
        let mut buffers = HashMap::new();
        for index in document.needed_buffers() {
            buffers.entry(index).or_insert_with(|| buffer(document, binary, index as usize));
        }
        Self { document, buffers, left: Cell::new(most) }
    }

    pub(super) fn spend(&self, bytes: usize) -> Result<(), DataError> {
        self.left.set(self.left.get().checked_sub(bytes).ok_or_else(repeated)?);
        Ok(())
    }

    /// How many numbers an element of an accessor has; 0 if it is not there.
    pub(super) fn components(&self, accessor: u32) -> usize {
        self.document.accessors.get(accessor as usize).map_or(0, Accessor::components)
    }

    /// The numbers of an accessor with at least one element.
    pub(super) fn numbers(&self, accessor: u32, components: usize) -> Result<Numbers<'_>, DataError> {
        let index = accessor as usize;
        let wrong = |message: &str| DataError::Element { element: "accessor", index, message: message.to_owned() };
        let accessor = self.document.accessors.get(index).ok_or_else(|| wrong("it is named, and there is none"))?;
        if accessor.components() != components {
            return Err(wrong("it is of another type than what it is used for"));
        }
        let (kind, one) = kind(accessor.component_type).ok_or_else(|| wrong("its type of numbers is not known"))?;
        let one = if accessor.normalized { one } else { 1.0 };
        let count = accessor.count;
        if count == 0 {
            return Err(wrong("it has no elements"));
        }
        self.spend(count.saturating_mul(8 * components))?;
        let shape = Shape { kind, one, components, count };
        let base = match accessor.buffer_view {
            Some(view) => Some(self.bytes(index, (view, accessor.byte_offset), shape)?),
            None if accessor.sparse.is_none() => return Err(wrong("its buffer view is not there")),
            None => None,
        };
        let Some(sparse) = &accessor.sparse else {
            return base.ok_or_else(|| wrong("its buffer view is not there"));
        };
        let part = |part: &Part| part.buffer_view.map(|view| (view, part.byte_offset));
        let indices = part(&sparse.indices).zip(self::kind(sparse.indices.component_type));
        let (Some((at, (kind, _))), Some(values)) = (indices, part(&sparse.values)) else {
            return Err(wrong("it is sparse, and its parts are not there"));
        };
        let few = sparse.count.min(count).max(1);
        let of_indices = Shape { kind, one: 1.0, components: 1, count: few };
        let indices = self.bytes(index, at, of_indices)?;
        let values = self.bytes(index, values, Shape { count: few, ..shape })?;
        if base.is_none() && count / 64 > few {
            // Of nearly nothing much would be made.
            return Err(wrong("it is sparse with few values; export it without"));
        }
        let mut all = match &base {
            Some(base) => (0..count).flat_map(|i| (0..components).map(move |k| base.at(i, k))).collect(),
            None => vec![0.0; count.saturating_mul(components)],
        };
        for k in 0..if sparse.count == 0 { 0 } else { few } {
            let element = indices.at(k, 0) as usize;
            let place = all.get_mut(element.saturating_mul(components)..).and_then(|rest| rest.get_mut(..components));
            let place = place.ok_or_else(|| wrong("it is sparse, and names an element that is not there"))?;
            place.iter_mut().enumerate().for_each(|(n, x)| *x = values.at(k, n));
        }
        Ok(Numbers { shape: Shape { one: 1.0, ..shape }, of: Of::Values(all) })
    }

    fn bytes(&self, index: usize, (view, offset): (u32, usize), shape: Shape) -> Result<Numbers<'_>, DataError> {
        let wrong = |message: &str| DataError::Element { element: "accessor", index, message: message.to_owned() };
        let view = self.document.views.get(view as usize).ok_or_else(|| wrong("its buffer view is not there"))?;
        let View { buffer: Some(buffer), byte_offset, byte_length, byte_stride } = *view else {
            return Err(wrong("its buffer is not there"));
        };
        let size = shape.kind.bytes() * shape.components;
        let stride = byte_stride.unwrap_or(size);
        if stride < size {
            return Err(wrong("its stride is less than its elements' size"));
        }
        let length = stride.saturating_mul(shape.count - 1).saturating_add(size);
        let buffer = self.buffers.get(&buffer).ok_or_else(|| wrong("its buffer is not there"))?.as_ref();
        let buffer = buffer.map_err(DataError::clone)?;
        let data = buffer.get(byte_offset..).and_then(|rest| rest.get(..byte_length));
        let data = data.and_then(|view| view.get(offset..)?.get(..length));
        let beyond = || DataError::Truncated(format!("accessor {index} has {length} bytes that its buffer has not"));
        Ok(Numbers { shape, of: Of::Bytes(data.ok_or_else(beyond)?, stride) })
    }
}

fn buffer<'a>(document: &Document<'_>, binary: Option<&'a [u8]>, index: usize) -> Result<Cow<'a, [u8]>, DataError> {
    let wrong = |message: String| DataError::Element { element: "buffer", index, message };
    let buffer = document.buffers.get(index).ok_or_else(|| wrong("it is named, and there is none".to_owned()))?;
    match &buffer.uri {
        None if index == 0 => Ok(binary.unwrap_or_default().into()),
        None => Err(wrong("it has no data".to_owned())),
        Some(Text(uri)) if uri.starts_with("data:") => {
            let text = uri.split_once(";base64,").map(|(_, text)| text);
            let text = text.ok_or_else(|| wrong("its data are not in base64".to_owned()))?;
            Ok(STANDARD.decode(text).map_err(|error| wrong(error.to_string()))?.into())
        }
        Some(Text(uri)) => {
            let name = plain(uri, 60);
            Err(wrong(format!("its data are in another file, {name:?}, which did not come with it; export it as .glb")))
        }
    }
}

#[derive(Clone, Copy)]
struct Shape {
    kind: Kind,
    /// The number that stands for 1.
    one: f64,
    components: usize,
    count: usize,
}

/// The numbers of an accessor.
pub(super) struct Numbers<'b> {
    shape: Shape,
    of: Of<'b>,
}

enum Of<'b> {
    /// With the distance of an element from the next one.
    Bytes(&'b [u8], usize),
    Values(Vec<f64>),
}

impl Numbers<'_> {
    pub(super) fn count(&self) -> usize {
        self.shape.count
    }

    pub(super) fn components(&self) -> usize {
        self.shape.components
    }

    /// Whether these are bytes for 0 to 1.
    pub(super) fn is_of_bytes(&self) -> bool {
        self.shape.kind == Kind::U8 && self.shape.one != 1.0
    }

    /// A component of an element, which is there.
    pub(super) fn at(&self, element: usize, component: usize) -> f64 {
        let Shape { kind, one, components, .. } = self.shape;
        match &self.of {
            Of::Values(values) => values[element * components + component],
            Of::Bytes(bytes, stride) => {
                fn one_of<const N: usize>(bytes: &[u8], number: impl Fn([u8; N]) -> f64) -> f64 {
                    bytes.first_chunk::<N>().map_or(f64::NAN, |&bytes| number(bytes))
                }
                let bytes = &bytes[element * stride + component * kind.bytes()..];
                let number = numbers!(kind, f64, one_of(bytes));
                if one == 1.0 { number } else { (number / one).max(-1.0) }
            }
        }
    }
}
