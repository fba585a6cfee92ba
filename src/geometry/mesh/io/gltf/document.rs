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
use crate::mesh::io::regions;
use crate::mesh::io::{DataError, syntax};
use crate::mesh::regions::MAX_REGIONS;

/// No element.
const NONE: u32 = u32::MAX;

#[derive(Debug, Default)]
pub(super) struct Document<'a> {
    scene: u32,
    scenes: Vec<u32>,
    scene_ends: Vec<u32>,
    pub(super) nodes: Vec<Node>,
    children: Vec<u32>,
    /// Nodes with their skins.
    skinned: Vec<(u32, u32)>,
    skins: Vec<Skin>,
    joints: Vec<u32>,
    /// Numbers of matrices, or of translations, rotations and scales.
    numbers: Vec<f64>,
    primitives: Vec<Primitive>,
    mesh_ends: Vec<u32>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) views: Vec<View>,
    pub(super) buffers: Vec<Buffer<'a>>,
    /// Materials with a name.
    materials: Vec<(u32, String)>,
    count_of_materials: u32,
    /// The first extension that the surface needs and that is not read, and the first that it could do with.
    required: Option<String>,
    pub(super) used: Option<String>,
    room: Room,
}

/// Parts of the names of extensions that change no surface, or are read.
const HARMLESS: [&str; 9] =
    ["_materials_", "_texture_", "_lights_", "_animation", "_xmp", "_audio", "_image", "_quantization", "_metadata"];

/// Notes the first extension that is not read.
fn note(first: &mut Option<String>, name: &str) {
    if !name.is_empty() && !HARMLESS.iter().any(|part| name.contains(part)) {
        first.get_or_insert_with(|| plain(name, 60));
    }
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

/// Joints, and the inverses of their places at which the surface was bound to them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Skin {
    /// An accessor.
    pub(super) inverses: Option<u32>,
    /// The end of its joints.
    end: u32,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: Names,
    pub(super) indices: Option<u32>,
    mode: Option<u32>,
    #[serde(deserialize_with = "loose")]
    pub(super) material: Option<u32>,
    /// Whether it has morph targets.
    #[serde(rename = "targets", deserialize_with = "is_there")]
    pub(super) is_morphed: bool,
}

/// Accessors of what vertices carry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Names {
    pub(super) position: Option<u32>,
    pub(super) normal: Option<u32>,
    pub(super) texture: Option<u32>,
    pub(super) colour: Option<u32>,
    pub(super) joints_0: Option<u32>,
    pub(super) weights_0: Option<u32>,
    pub(super) joints_1: Option<u32>,
    pub(super) weights_1: Option<u32>,
    /// Whether there are others.
    pub(super) has_more: bool,
}

impl<'de> Deserialize<'de> for Names {
    fn deserialize<D: Deserializer<'de>>(reader: D) -> Result<Self, D::Error> {
        struct All;
        impl<'de> Visitor<'de> for All {
            type Value = Names;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("attributes by their names")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Names, A::Error> {
                let mut names = Names::default();
                while let Some(name) = map.next_key::<Text<'de>>()? {
                    let to = match name.0.as_ref() {
                        "POSITION" => {
                            names.position = map.next_value()?;
                            continue;
                        }
                        "NORMAL" => &mut names.normal,
                        "TEXCOORD_0" => &mut names.texture,
                        "COLOR_0" => &mut names.colour,
                        "JOINTS_0" => &mut names.joints_0,
                        "WEIGHTS_0" => &mut names.weights_0,
                        "JOINTS_1" => &mut names.joints_1,
                        "WEIGHTS_1" => &mut names.weights_1,
                        _ => {
                            names.has_more = true;
                            map.next_value::<IgnoredAny>()?;
                            continue;
                        }
                    };
                    *to = map.next_value::<Loose>()?.0;
                }
                Ok(names)
            }
        }
        reader.deserialize_map(All)
    }
}

impl Primitive {
    /// The kind of its triangles, from 4 to 6, and the accessor of its positions.
    pub(super) fn triangles(&self) -> Option<(u32, u32)> {
        Some((self.mode.unwrap_or(4), self.attributes.position?)).filter(|(mode, _)| (4..=6).contains(mode))
    }
}

/// One that nothing uses may say anything.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    #[serde(deserialize_with = "loose")]
    pub(super) buffer_view: Option<u32>,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) component_type: u32,
    pub(super) normalized: bool,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) count: usize,
    #[serde(rename = "type")]
    shape: Shape,
    pub(super) sparse: Option<Box<Sparse>>,
}

/// Elements that replace those of the accessor.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Sparse {
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) count: usize,
    pub(super) indices: Part,
    pub(super) values: Part,
}

/// Numbers in a buffer view.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Part {
    #[serde(deserialize_with = "loose")]
    pub(super) buffer_view: Option<u32>,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) component_type: u32,
}

/// A shape's number is that of its components.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Shape {
    Scalar = 1,
    Vec2 = 2,
    Vec3 = 3,
    Vec4 = 4,
    Mat4 = 16,
    #[default]
    #[serde(other)]
    Other = 0,
}

impl Accessor {
    pub(super) fn components(&self) -> usize {
        self.shape as usize
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct View {
    #[serde(deserialize_with = "loose")]
    pub(super) buffer: Option<u32>,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) byte_offset: usize,
    #[serde(deserialize_with = "loose_or_0")]
    pub(super) byte_length: usize,
    #[serde(deserialize_with = "loose")]
    pub(super) byte_stride: Option<usize>,
}

/// A number from 0, or nothing of any other value.
#[derive(Deserialize)]
#[serde(transparent)]
struct Loose(#[serde(deserialize_with = "loose")] Option<u32>);

fn loose<'a, D: Deserializer<'a>, T: TryFrom<u64>>(reader: D) -> Result<Option<T>, D::Error> {
    struct Any;
    impl<'a> Visitor<'a> for Any {
        type Value = Option<u64>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a number")
        }

        fn visit_u64<E>(self, number: u64) -> Result<Option<u64>, E> {
            Ok(Some(number))
        }

        fn visit_i64<E>(self, _: i64) -> Result<Option<u64>, E> {
            Ok(None)
        }

        fn visit_f64<E>(self, number: f64) -> Result<Option<u64>, E> {
            Ok((number >= 0.0 && number.fract() == 0.0).then_some(number as u64))
        }

        fn visit_bool<E>(self, _: bool) -> Result<Option<u64>, E> {
            Ok(None)
        }

        fn visit_str<E>(self, _: &str) -> Result<Option<u64>, E> {
            Ok(None)
        }

        fn visit_unit<E>(self) -> Result<Option<u64>, E> {
            Ok(None)
        }

        fn visit_seq<A: SeqAccess<'a>>(self, mut seq: A) -> Result<Option<u64>, A::Error> {
            while seq.next_element::<IgnoredAny>()?.is_some() {}
            Ok(None)
        }

        fn visit_map<A: MapAccess<'a>>(self, mut map: A) -> Result<Option<u64>, A::Error> {
            while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
            Ok(None)
        }
    }
    Ok(reader.deserialize_any(Any)?.and_then(|number| T::try_from(number).ok()))
}

fn loose_or_0<'a, D: Deserializer<'a>, T: TryFrom<u64> + Default>(reader: D) -> Result<T, D::Error> {
    Ok(loose(reader)?.unwrap_or_default())
}

/// Reads a name, or that of an object. Any other value has none.
#[derive(Clone, Copy)]
struct Name {
    /// Whether the name is that of an object.
    is_within: bool,
}

impl<'a> DeserializeSeed<'a> for Name {
    type Value = String;

    fn deserialize<D: Deserializer<'a>>(self, reader: D) -> Result<String, D::Error> {
        reader.deserialize_any(self)
    }
}

impl<'a> Visitor<'a> for Name {
    type Value = String;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name")
    }

    fn visit_u64<E>(self, _: u64) -> Result<String, E> {
        Ok(String::new())
    }

    fn visit_i64<E>(self, _: i64) -> Result<String, E> {
        Ok(String::new())
    }

    fn visit_f64<E>(self, _: f64) -> Result<String, E> {
        Ok(String::new())
    }

    fn visit_bool<E>(self, _: bool) -> Result<String, E> {
        Ok(String::new())
    }

    fn visit_unit<E>(self) -> Result<String, E> {
        Ok(String::new())
    }

    fn visit_str<E>(self, name: &str) -> Result<String, E> {
        Ok(if self.is_within { String::new() } else { regions::name(name.as_bytes()) })
    }

    fn visit_seq<A: SeqAccess<'a>>(self, mut seq: A) -> Result<String, A::Error> {
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        Ok(String::new())
    }

    fn visit_map<A: MapAccess<'a>>(self, mut map: A) -> Result<String, A::Error> {
        let mut found = String::new();
        while let Some(Text(key)) = map.next_key()? {
            match self.is_within && key == "name" {
                true => found = map.next_value_seed(Self { is_within: false })?,
                false => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok(found)
    }
}

fn is_there<'a, D: Deserializer<'a>>(reader: D) -> Result<bool, D::Error> {
    IgnoredAny::deserialize(reader).map(|_| true)
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
        let Some(by) = document.required else { return Ok(document) };
        Err(DataError::Header(format!("it requires the extension {by}, which is not read; export it without")))
    }

    /// The name of a material.
    pub(super) fn material(&self, index: u32) -> Option<&str> {
        let at = self.materials.binary_search_by_key(&index, |&(index, _)| index).ok()?;
        Some(&self.materials[at].1)
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

    /// Buffers with numbers of accessors, some of them several times.
    pub(super) fn needed_buffers(&self) -> impl Iterator<Item = u32> {
        let parts = |accessor: &'_ Accessor| {
            let sparse = accessor.sparse.as_ref();
            [
                accessor.buffer_view,
                sparse.and_then(|sparse| sparse.indices.buffer_view),
                sparse.and_then(|sparse| sparse.values.buffer_view),
            ]
        };
        let views = self.accessors.iter().flat_map(parts).flatten();
        views.filter_map(|view| self.views.get(view as usize)?.buffer)
    }

    /// The number of a node's skin.
    pub(super) fn skin(&self, node: usize) -> Option<u32> {
        let at = self.skinned.binary_search_by_key(&(node as u32), |&(node, _)| node).ok()?;
        Some(self.skinned[at].1)
    }

    /// A skin and its joints.
    pub(super) fn joints(&self, skin: u32) -> Option<(Skin, &[u32])> {
        let index = skin as usize;
        let skin = *self.skins.get(index)?;
        let begin = index.checked_sub(1).map_or(0, |before| self.skins[before].end);
        Some((skin, &self.joints[begin as usize..skin.end as usize]))
    }

    /// For each node the one whose child it is, if there is one.
    pub(super) fn parents(&self) -> Vec<Option<u32>> {
        let mut parents = vec![None; self.nodes.len()];
        for node in 0..self.nodes.len() {
            for &child in self.children(node) {
                parents.get_mut(child as usize).into_iter().for_each(|parent| *parent = Some(node as u32));
            }
        }
        parents
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

    fn part(&mut self, at: At) -> Reading<'_, 'a> {
        Reading { document: self, at }
    }

    /// Adds a node with the children that were read since the one before.
    fn end_node(
        &mut self,
        Placed { mesh, skin, matrix, translation, rotation, scale }: Placed,
    ) -> Result<(), DataError> {
        if let Some(skin) = skin {
            self.room.push(&mut self.skinned, (self.nodes.len() as u32, skin))?;
        }
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
    skin: Option<u32>,
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
    Skins,
    Skin,
    Joints,
    Accessors,
    Views,
    Buffers,
    Required,
    Used,
    Materials,
}

struct Reading<'d, 'a> {
    document: &'d mut Document<'a>,
    at: At,
}

impl<'a> DeserializeSeed<'a> for Reading<'_, 'a> {
    type Value = ();

    fn deserialize<D: Deserializer<'a>>(self, reader: D) -> Result<(), D::Error> {
        match self.at {
            At::Root | At::Scene | At::Node | At::Mesh | At::Skin => reader.deserialize_map(self),
            _ => reader.deserialize_seq(self),
        }
    }
}

impl<'a> Visitor<'a> for Reading<'_, 'a> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.at {
            At::Root | At::Scene | At::Node | At::Mesh | At::Skin => "an object",
            _ => "an array",
        })
    }

    fn visit_map<A: MapAccess<'a>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { document, at } = self;
        let mut node = Placed::default();
        let mut inverses = None;
        while let Some(Text(key)) = map.next_key()? {
            let list = match (at, &*key) {
                (At::Root, "scenes") => At::Scenes,
                (At::Root, "nodes") => At::Nodes,
                (At::Root, "meshes") => At::Meshes,
                (At::Root, "skins") => At::Skins,
                (At::Root, "accessors") => At::Accessors,
                (At::Root, "bufferViews") => At::Views,
                (At::Root, "buffers") => At::Buffers,
                (At::Root, "extensionsRequired") => At::Required,
                (At::Root, "extensionsUsed") => At::Used,
                (At::Root, "materials") => At::Materials,
                (At::Scene, "nodes") => At::SceneNodes,
                (At::Node, "children") => At::Children,
                (At::Mesh, "primitives") => At::Primitives,
                (At::Skin, "joints") => At::Joints,
                _ => {
                    match (at, &*key) {
                        (At::Root, "scene") => document.scene = map.next_value()?,
                        (At::Node, "mesh") => node.mesh = map.next_value()?,
                        (At::Node, "skin") => node.skin = map.next_value::<Loose>()?.0,
                        (At::Skin, "inverseBindMatrices") => inverses = map.next_value::<Loose>()?.0,
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
        let Document { scenes, scene_ends, primitives, mesh_ends, skins, joints, room, .. } = document;
        match at {
            At::Scene => room.push(scene_ends, scenes.len() as u32),
            At::Mesh => room.push(mesh_ends, primitives.len() as u32),
            At::Skin => room.push(skins, Skin { inverses, end: joints.len() as u32 }),
            At::Node => document.end_node(node),
            _ => Ok(()),
        }
        .map_err(A::Error::custom)
    }

    fn visit_seq<A: SeqAccess<'a>>(self, mut seq: A) -> Result<(), A::Error> {
        let Self { document, at } = self;
        loop {
            let Document { scenes, children, primitives, joints, accessors, views, buffers, .. } = document;
            let Document { materials, count_of_materials, required, used, room, .. } = document;
            macro_rules! element {
                ($list:expr) => {
                    seq.next_element()?.map(|element| room.push($list, element))
                };
            }
            let pushed = match at {
                At::Scenes => seq.next_element_seed(document.part(At::Scene))?.map(Ok),
                At::Nodes => seq.next_element_seed(document.part(At::Node))?.map(Ok),
                At::Meshes => seq.next_element_seed(document.part(At::Mesh))?.map(Ok),
                At::Skins => seq.next_element_seed(document.part(At::Skin))?.map(Ok),
                At::Joints => element!(joints),
                At::SceneNodes => element!(scenes),
                At::Children => element!(children),
                At::Primitives => element!(primitives),
                At::Accessors => seq.next_element::<Accessor>()?.map(|accessor| {
                    room.take(if accessor.sparse.is_some() { size_of::<Sparse>() } else { 0 })?;
                    room.push(accessors, accessor)
                }),
                At::Views => element!(views),
                At::Buffers => element!(buffers),
                At::Materials => seq.next_element_seed(Name { is_within: true })?.map(|name| {
                    let index = *count_of_materials;
                    *count_of_materials = index.saturating_add(1);
                    if name.is_empty() || materials.len() == MAX_REGIONS {
                        return Ok(());
                    }
                    room.take(name.len())?;
                    room.push(materials, (index, name))
                }),
                _ => seq.next_element::<Text<'_>>()?.map(|Text(name)| {
                    note(if at == At::Required { &mut *required } else { &mut *used }, &name);
                    Ok(())
                }),
            };
            let Some(pushed) = pushed else { return Ok(()) };
            pushed.map_err(A::Error::custom)?;
        }
    }
}
