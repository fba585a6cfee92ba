//! The document of a glTF: its JSON, as lists.
//!
//! Purpose: [`Document::read`] goes over the JSON once. The parts that a surface needs become lists of numbers, others are skipped;
//! the data of buffers stay where they are in the text.
//! Invariant: the lists take memory in proportion to the JSON ([`Room`]), whatever it says. Must not know: numbers of accessors.

use std::borrow::Cow;
use std::fmt;

use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use crate::mesh::io::numbers::plain;
use crate::mesh::io::packed::Room;
use crate::mesh::io::{DataError, syntax};

/// No element.
const NONE: u32 = u32::MAX;

#[derive(Debug, Default)]
pub(super) struct Document<'a> {
    scene: u32,
    scenes: Vec<u32>,
    scene_ends: Vec<u32>,
    pub(super) nodes: Vec<Node>,
    children: Vec<u32>,
    /// Numbers of matrices, or of translations, rotations and scales.
    numbers: Vec<f64>,
    primitives: Vec<Primitive>,
    mesh_ends: Vec<u32>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) views: Vec<View>,
    pub(super) buffers: Vec<Buffer<'a>>,
    packing: Option<String>,
    room: Room,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    mesh: u32,
    /// The end of its children.
    end: u32,
    /// The end of its numbers.
    place: u32,
    /// Whether it has a translation, a rotation, a scale.
    has: [bool; 3],
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: Names,
    pub(super) indices: Option<u32>,
    mode: Option<u32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "SCREAMING_SNAKE_CASE")]
pub(super) struct Names {
    pub(super) position: Option<u32>,
    pub(super) normal: Option<u32>,
    #[serde(rename = "TEXCOORD_0")]
    pub(super) texture: Option<u32>,
    #[serde(rename = "COLOR_0")]
    pub(super) colour: Option<u32>,
}

impl Primitive {
    /// The kind of its triangles, from 4 to 6, and the accessor of its positions.
    pub(super) fn triangles(&self) -> Option<(u32, u32)> {
        Some((self.mode.unwrap_or(4), self.attributes.position?)).filter(|(mode, _)| (4..=6).contains(mode))
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<u32>,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: usize,
    #[serde(rename = "type")]
    shape: Shape,
    pub(super) sparse: Option<IgnoredAny>,
}

/// A shape's number is that of its components.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Shape {
    Scalar = 1,
    Vec2 = 2,
    Vec3 = 3,
    Vec4 = 4,
    #[serde(other)]
    Other = 0,
}

impl Accessor {
    pub(super) fn components(&self) -> usize {
        self.shape as usize
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    pub(super) buffer: u32,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Buffer<'a> {
    #[serde(borrow)]
    pub(super) uri: Option<Text<'a>>,
}

/// Text that is not copied, unless it has escapes.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
pub(super) struct Text<'a>(#[serde(borrow)] pub(super) Cow<'a, str>);

impl<'a> Document<'a> {
    pub(super) fn read(json: &'a [u8]) -> Result<Self, DataError> {
        let mut document = Self { room: Room::of(json.len()), ..Self::default() };
        let mut reader = serde_json::Deserializer::from_slice(json);
        let read = document.part(At::Root).deserialize(&mut reader).and_then(|()| reader.end());
        read.map_err(|error| match error.is_eof() {
            true => DataError::Truncated("its JSON is not whole".to_owned()),
            false => syntax(error.line().max(1), plain(&error.to_string(), 200)),
        })?;
        let Some(by) = document.packing else { return Ok(document) };
        Err(DataError::Header(format!("it is packed with {by}, which is not read; export it without")))
    }

    pub(super) fn bytes(&self) -> usize {
        self.room.taken()
    }

    /// Nodes of the scene; if there is none, those that are no other's child.
    pub(super) fn roots(&self) -> Vec<u32> {
        match self.scene_ends.get(self.scene as usize) {
            Some(_) => within(&self.scenes, &self.scene_ends, self.scene as usize).to_vec(),
            None => {
                let mut is_child = vec![false; self.nodes.len()];
                for &child in &self.children {
                    is_child.get_mut(child as usize).into_iter().for_each(|is| *is = true);
                }
                (0..self.nodes.len() as u32).filter(|&node| !is_child[node as usize]).collect()
            }
        }
    }

    /// Children of a node, which is there.
    pub(super) fn children(&self, node: usize) -> &[u32] {
        let begin = node.checked_sub(1).map_or(0, |before| self.nodes[before].end);
        &self.children[begin as usize..self.nodes[node].end as usize]
    }

    /// The mesh of a node, which is there.
    pub(super) fn mesh(&self, node: usize) -> Option<usize> {
        Some(self.nodes[node].mesh).filter(|&mesh| mesh != NONE).map(|mesh| mesh as usize)
    }

    pub(super) fn primitives(&self, mesh: usize) -> Option<&[Primitive]> {
        (mesh < self.mesh_ends.len()).then(|| within(&self.primitives, &self.mesh_ends, mesh))
    }

    /// The place of a node, which is there, in that of its parent.
    pub(super) fn place(&self, node: usize) -> DMat4 {
        let begin = node.checked_sub(1).map_or(0, |before| self.nodes[before].place);
        let Node { place, has, .. } = self.nodes[node];
        let mut numbers = &self.numbers[begin as usize..place as usize];
        if let Ok(matrix) = <&[f64; 16]>::try_from(numbers) {
            return DMat4::from_cols_array(matrix);
        }
        let mut next = |is_there: bool, count: usize| {
            let (found, rest) = numbers.split_at(if is_there { count } else { 0 });
            numbers = rest;
            is_there.then_some(found)
        };
        let translation = next(has[0], 3).map_or(DVec3::ZERO, DVec3::from_slice);
        let rotation = next(has[1], 4).map_or(DQuat::IDENTITY, DQuat::from_slice);
        let scale = next(has[2], 3).map_or(DVec3::ONE, DVec3::from_slice);
        let columns = DMat4::from_quat(rotation);
        let turned = [columns.x_axis * scale.x, columns.y_axis * scale.y, columns.z_axis * scale.z];
        DMat4::from_cols(turned[0], turned[1], turned[2], translation.extend(1.0))
    }

    fn part(&mut self, at: At) -> Part<'_, 'a> {
        Part { document: self, at }
    }

    /// Adds a node with the children that were read since the one before.
    fn end_node(&mut self, Placed { mesh, matrix, translation, rotation, scale }: Placed) -> Result<(), DataError> {
        let parts =
            [translation.as_ref().map(|t| &t[..]), rotation.as_ref().map(|r| &r[..]), scale.as_ref().map(|s| &s[..])];
        let parts = parts.map(|part| part.filter(|_| matrix.is_none()));
        for &number in matrix.iter().map(|matrix| &matrix[..]).chain(parts.into_iter().flatten()).flatten() {
            self.room.push(&mut self.numbers, number)?;
        }
        let (end, place) = (self.children.len() as u32, self.numbers.len() as u32);
        let node = Node { mesh: mesh.unwrap_or(NONE), end, place, has: parts.map(|part| part.is_some()) };
        self.room.push(&mut self.nodes, node)
    }
}

/// The part of a list that belongs to one of those whose ends these are.
fn within<'l, T>(list: &'l [T], ends: &[u32], index: usize) -> &'l [T] {
    let begin = index.checked_sub(1).map_or(0, |before| ends[before]);
    &list[begin as usize..ends[index] as usize]
}

/// A node as it is written.
#[derive(Default)]
struct Placed {
    mesh: Option<u32>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum At {
    Root,
    Scenes,
    Scene,
    SceneNodes,
    Nodes,
    Node,
    Children,
    Meshes,
    Mesh,
    Primitives,
    Accessors,
    Views,
    Buffers,
    Required,
}

struct Part<'d, 'a> {
    document: &'d mut Document<'a>,
    at: At,
}

impl<'a> DeserializeSeed<'a> for Part<'_, 'a> {
    type Value = ();

    fn deserialize<D: Deserializer<'a>>(self, reader: D) -> Result<(), D::Error> {
        match self.at {
            At::Root | At::Scene | At::Node | At::Mesh => reader.deserialize_map(self),
            _ => reader.deserialize_seq(self),
        }
    }
}

impl<'a> Visitor<'a> for Part<'_, 'a> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.at {
            At::Root | At::Scene | At::Node | At::Mesh => "an object",
            _ => "an array",
        })
    }

    fn visit_map<A: MapAccess<'a>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { document, at } = self;
        let mut node = Placed::default();
        while let Some(Text(key)) = map.next_key()? {
            let list = match (at, &*key) {
                (At::Root, "scenes") => At::Scenes,
                (At::Root, "nodes") => At::Nodes,
                (At::Root, "meshes") => At::Meshes,
                (At::Root, "accessors") => At::Accessors,
                (At::Root, "bufferViews") => At::Views,
                (At::Root, "buffers") => At::Buffers,
                (At::Root, "extensionsRequired") => At::Required,
                (At::Scene, "nodes") => At::SceneNodes,
                (At::Node, "children") => At::Children,
                (At::Mesh, "primitives") => At::Primitives,
                _ => {
                    match (at, &*key) {
                        (At::Root, "scene") => document.scene = map.next_value()?,
                        (At::Node, "mesh") => node.mesh = map.next_value()?,
                        (At::Node, "matrix") => node.matrix = map.next_value()?,
                        (At::Node, "translation") => node.translation = map.next_value()?,
                        (At::Node, "rotation") => node.rotation = map.next_value()?,
                        (At::Node, "scale") => node.scale = map.next_value()?,
                        _ => drop(map.next_value::<IgnoredAny>()?),
                    }
                    continue;
                }
            };
            map.next_value_seed(document.part(list))?;
        }
        let Document { scenes, scene_ends, primitives, mesh_ends, room, .. } = document;
        match at {
            At::Scene => room.push(scene_ends, scenes.len() as u32),
            At::Mesh => room.push(mesh_ends, primitives.len() as u32),
            At::Node => document.end_node(node),
            _ => Ok(()),
        }
        .map_err(A::Error::custom)
    }

    fn visit_seq<A: SeqAccess<'a>>(self, mut seq: A) -> Result<(), A::Error> {
        let Self { document, at } = self;
        loop {
            let Document { scenes, children, primitives, accessors, views, buffers, packing, room, .. } = document;
            macro_rules! element {
                ($list:expr) => {
                    seq.next_element()?.map(|element| room.push($list, element))
                };
            }
            let pushed = match at {
                At::Scenes => seq.next_element_seed(document.part(At::Scene))?.map(Ok),
                At::Nodes => seq.next_element_seed(document.part(At::Node))?.map(Ok),
                At::Meshes => seq.next_element_seed(document.part(At::Mesh))?.map(Ok),
                At::SceneNodes => element!(scenes),
                At::Children => element!(children),
                At::Primitives => element!(primitives),
                At::Accessors => element!(accessors),
                At::Views => element!(views),
                At::Buffers => element!(buffers),
                _ => seq.next_element::<Text<'_>>()?.map(|Text(name)| {
                    if name.contains("compression") {
                        packing.get_or_insert_with(|| plain(&name, 60));
                    }
                    Ok(())
                }),
            };
            let Some(pushed) = pushed else { return Ok(()) };
            pushed.map_err(A::Error::custom)?;
        }
    }
}
