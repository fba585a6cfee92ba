//! Recorded uploads made of bytes, and what must hold of each.
//!
//! Invariant: the same bytes give the same recording everywhere; bytes that are missing read as 0.
#![allow(dead_code)]

use prost::Message;
use server::config::Limits;
use server::service::replay;
use tessera::cvt::DensitySource;
use tessera::proto::*;
use tessera::remesh::Seeds;

/// Small, so that every limit is met.
fn limits() -> Limits {
    Limits { max_vertices: 200, max_facets: 400, max_seeds: 300, memory_bytes: 8000, ..Limits::default() }
}

/// Bytes as they are, or, if the first one is even, as orders for a client that errs now and then; half of the first
/// one says what the mesh carries. Says whether the upload was taken.
///
/// # Errors
/// What is wrong with the answer.
pub fn check(data: &[u8]) -> Result<bool, String> {
    let Some((&first, rest)) = data.split_first() else { return Ok(false) };
    let (recording, whole) = if first % 2 == 1 { (rest.to_vec(), false) } else { client(rest, first / 2 % 4) };
    match replay(&recording, &limits()) {
        Err(text) if whole && !text.contains("facet") && !text.contains("vertex") && !text.contains("do not fit") => {
            Err(format!("a faultless upload is refused: {text}"))
        }
        Err(text) if text.is_empty() => Err("an error without words".to_owned()),
        Err(_) => Ok(false),
        Ok(input) => {
            let seeds = match &input.seeds {
                Seeds::Given(seeds) => seeds.len(),
                Seeds::Sample { points, .. } => *points,
                // The density says it later.
                _ => 1,
            };
            let (vertices, facets) = (input.mesh.positions().len(), input.mesh.facets().len());
            let fits = vertices <= 200 && facets <= 400 && (1..=300).contains(&seeds);
            let weighted = match &input.density.source {
                DensitySource::Weights(given) | DensitySource::Sizes(given) => given.len() == vertices,
                _ => true,
            };
            let carries = input.attributes.is_none_or(|attributes| attributes.check_mesh(&input.mesh).is_ok());
            if fits && weighted && carries {
                Ok(true)
            } else {
                Err(format!("{vertices} vertices, {facets} facets, {seeds} seeds"))
            }
        }
    }
}

/// The recording of a client, and whether it made no mistake.
fn client(data: &[u8], carried: u8) -> (Vec<u8>, bool) {
    let mut rest = data.iter().copied();
    let mut byte = || rest.next().unwrap_or(0);
    let mut whole = true;
    let (vertices, facets) = (u64::from(byte() % 16) + 1, u64::from(byte() % 16) + 1);
    let (double, weighted, sampled) = (byte() % 2 == 0, byte() % 4 == 0, byte() % 2 == 0);
    let count = u64::from(byte() % 8) + 1;
    let weights = if weighted { vertices } else { 0 };
    let attributes = announced(carried, vertices, facets);
    let position_type = if double { 2 } else { 1 };
    let mut mesh = MeshHeader {
        vertices,
        facets,
        position_type,
        weights,
        attributes: attributes.clone(),
        ..MeshHeader::default()
    };
    if byte() % 32 == 31 {
        whole = false;
        match byte() % 4 {
            0 => mesh.vertices = u64::MAX / (1 + u64::from(byte())),
            1 => mesh.facets = u64::MAX,
            2 => mesh.position_type = i32::from(byte()) - 100,
            _ => mesh.weights = u64::from(byte()),
        }
    }
    let points = sampled.then_some(count as u32);
    let header = RemeshHeader {
        mesh: Some(mesh),
        seeds: if sampled { 0 } else { count },
        backend: 0,
        options: Some(RemeshOptions { points, seed: Some(1), lloyd: Some(1), ..RemeshOptions::default() }),
    };
    let mut out = Vec::new();
    let mut send = |message| {
        let request = RemeshRequest { message: Some(message) };
        request.encode_length_delimited(&mut out).unwrap();
    };
    send(remesh_request::Message::Header(header));
    let number = if double { 8 } else { 4 };
    let points = |n: u64, seed: u8| -> Vec<u8> {
        let values = (0..3 * n).map(|i| ((i * i + u64::from(seed)) % 17) as f64);
        values.flat_map(|x| if double { x.to_le_bytes().to_vec() } else { (x as f32).to_le_bytes().to_vec() }).collect()
    };
    let corners: Vec<u8> = (0..3 * facets).flat_map(|i| ((i % vertices) as u32).to_le_bytes()).collect();
    let mut arrays = vec![
        (ArrayKind::Positions, points(vertices, byte())),
        (ArrayKind::Facets, corners),
        (ArrayKind::Weights, (0..weights).flat_map(|_| 1f64.to_le_bytes()).collect()),
        (ArrayKind::Seeds, if sampled { Vec::new() } else { points(count, byte()) }),
    ];
    debug_assert_eq!(arrays[0].1.len() as u64, 3 * number * vertices);
    let turn = usize::from(byte() % 4);
    arrays.rotate_left(turn);
    arrays.extend(attributes.iter().flat_map(|header| arrays_of(header, facets)));
    for (kind, array) in arrays {
        let mut offset = 0;
        while offset < array.len() {
            let length = (1 + usize::from(byte())).min(array.len() - offset);
            let data = array[offset..offset + length].to_vec();
            let mut chunk = Chunk {
                kind: kind.into(),
                offset: offset as u64,
                crc32c: crc32c::crc32c(&data),
                data: data.into(),
                total_bytes: if byte() % 2 == 0 { 0 } else { array.len() as u64 },
                ..Chunk::default()
            };
            if byte() % 32 == 31 {
                whole = false;
                match byte() % 6 {
                    0 => chunk.offset = u64::MAX - u64::from(byte()),
                    1 => chunk.offset = u64::from(byte()),
                    2 => {
                        chunk.kind = i32::from(byte()) - 8;
                        chunk.attribute = u32::from(byte());
                    }
                    3 => chunk.crc32c ^= 1 << (byte() % 32),
                    4 => chunk.total_bytes = u64::from(byte()) << (byte() % 57),
                    _ => chunk.data = vec![byte(); usize::from(byte())].into(),
                }
            }
            send(remesh_request::Message::Chunk(chunk));
            offset += length;
        }
    }
    if byte() % 16 == 15 {
        whole = false;
    } else {
        send(remesh_request::Message::Finish(Finish {}));
    }
    (out, whole)
}

/// What the mesh carries: nothing, a scalar, texture and colours, or all with normals by corner.
fn announced(carried: u8, vertices: u64, facets: u64) -> Vec<AttributeHeader> {
    let header = |kind: AttributeKind, r#type: AttributeType, values, by_corner| {
        let name = if kind == AttributeKind::Scalar { "a".to_owned() } else { String::new() };
        AttributeHeader {
            kind: kind.into(),
            name,
            r#type: r#type.into(),
            values,
            by_corner,
            components: 0,
            regions: Vec::new(),
        }
    };
    let mut all = Vec::new();
    if carried & 1 != 0 {
        all.push(header(AttributeKind::Scalar, AttributeType::F32, vertices, false));
    }
    if carried & 2 != 0 {
        all.push(header(AttributeKind::TextureCoordinates, AttributeType::F64, 2, false));
        all.push(header(AttributeKind::Colours, AttributeType::U8, vertices, false));
    }
    if carried == 3 {
        all.push(header(AttributeKind::Normals, AttributeType::F64, 3 * facets, true));
    }
    all
}

/// The arrays of an attribute: zeros, and corners that name the first value.
fn arrays_of(header: &AttributeHeader, facets: u64) -> Vec<(ArrayKind, Vec<u8>)> {
    let zeros = |bytes: u64| vec![0; (bytes * header.values) as usize];
    let corners = vec![0; 12 * facets as usize];
    match header.kind() {
        AttributeKind::Scalar => vec![(ArrayKind::Scalars, zeros(4))],
        AttributeKind::TextureCoordinates => {
            vec![(ArrayKind::TextureCoordinates, zeros(16)), (ArrayKind::TextureCorners, corners)]
        }
        AttributeKind::Colours => vec![(ArrayKind::Colours, zeros(4))],
        AttributeKind::Normals => vec![(ArrayKind::Normals, zeros(24)), (ArrayKind::NormalCorners, corners)],
        AttributeKind::Regions => vec![(ArrayKind::Regions, zeros(8))],
        AttributeKind::Unspecified => Vec::new(),
    }
}
