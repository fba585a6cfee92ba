//! Promise: what a surface cannot carry is left aside with a line, and never refuses or changes the surface of its file.

use std::fmt::Write as _;

use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::io::{
    Format, Loaded, RegionChoice, decode, decode_with_attributes, decode_with_regions, encode, encode_with_attributes,
};
use tessera::mesh::shapes::Shape;

/// A file with something odd in it, and whether a line is due.
struct Odd {
    what: String,
    format: Format,
    bytes: Vec<u8>,
    told: bool,
}

fn odd(what: impl Into<String>, format: Format, text: impl Into<Vec<u8>>, told: bool) -> Odd {
    Odd { what: what.into(), format, bytes: text.into(), told }
}

fn points(mesh: &TriMesh) -> String {
    mesh.positions().iter().map(|p| format!("{:?} {:?} {:?}\n", p.x, p.y, p.z)).collect()
}

fn faces(mesh: &TriMesh, before: &str, from: u32, after: &str) -> String {
    let face = |f: &[u32; 3]| format!("{before}{} {} {}{after}\n", f[0] + from, f[1] + from, f[2] + from);
    mesh.facets().iter().map(face).collect()
}

/// So many values: "7 7 7".
fn values(value: &str, count: usize) -> String {
    vec![value; count].join(" ")
}

fn legacy_vtk(mesh: &TriMesh) -> Vec<Odd> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let head = format!(
        "# vtk DataFile Version 5.1\ntitle\nASCII\nDATASET POLYDATA\nPOINTS {vertices} double\n{}POLYGONS {facets} {}\n{}",
        points(mesh),
        4 * facets,
        faces(mesh, "3 ", 0, "")
    );
    let mut all = Vec::new();
    let numbers =
        [8, 16, 32, 64].into_iter().flat_map(|bits| [format!("vtktypeint{bits}"), format!("vtktypeuint{bits}")]);
    let others =
        ["char", "signed_char", "unsigned_long_long", "vtkIdType", "float", "vtktypefloat64", "bit", "float16"];
    for kind in numbers.chain(others.map(str::to_owned)) {
        let told = kind == "float16";
        for (data, count) in [("CELL_DATA", facets), ("POINT_DATA", vertices)] {
            let array = |name: &str, kind: &str| format!("{name} 1 {count} {kind}\n{}\n", values("1", count));
            let text = format!(
                "{head}{data} {count}\nFIELD FieldData 2\n{}{}POINT_DATA {vertices}\nSCALARS height int 1\nLOOKUP_TABLE default\n{}\n",
                array("odd", &kind),
                array("region", "int"),
                values("3", vertices)
            );
            all.push(odd(format!("{kind} in {data}"), Format::Vtk, text, told || data == "CELL_DATA"));
        }
    }
    for (what, value) in [("string", "some words\n"), ("variant", "11 text ")] {
        let array = value.repeat(vertices);
        let text = format!("{head}POINT_DATA {vertices}\nFIELD FieldData 1\nodd 1 {vertices} {what}\n{array}\n");
        all.push(odd(what, Format::Vtk, text, true));
    }
    all.push(odd("an unknown section", Format::Vtk, format!("{head}POINT_DATA {vertices}\nSPLINES x\n1 2 3\n"), true));
    let binary = encode(Format::Vtk, mesh).unwrap();
    for kind in ["vtktypeint32", "vtktypeuint16", "float16"] {
        let size = if kind == "vtktypeint32" { 4 } else { 2 };
        let mut bytes = binary.clone();
        bytes.extend_from_slice(format!("\nCELL_DATA {facets}\nFIELD FieldData 1\nodd 1 {facets} {kind}\n").as_bytes());
        bytes.extend(vec![1; size * facets]);
        all.push(odd(format!("binary {kind}"), Format::Vtk, bytes, true));
    }
    all
}

fn xml_vtk(mesh: &TriMesh) -> Vec<Odd> {
    let mut all = Vec::new();
    for format in [Format::Vtp, Format::Vtu] {
        let plain = String::from_utf8(encode(format, mesh).unwrap()).unwrap();
        for (what, array) in [
            ("an unknown type", "<DataArray type=\"Float16\" Name=\"odd\" format=\"ascii\">1 2 3</DataArray>"),
            ("an unknown format", "<DataArray type=\"Float32\" Name=\"odd\" format=\"packed\">xyz</DataArray>"),
            ("strings", "<Array type=\"String\" Name=\"odd\" format=\"ascii\">65 66 0</Array>"),
            ("too few", "<DataArray type=\"Float32\" Name=\"odd\" format=\"ascii\">1 2</DataArray>"),
            ("no base64", "<DataArray type=\"Float32\" Name=\"odd\" format=\"binary\">###</DataArray>"),
            ("no data", "<DataArray type=\"Float32\" Name=\"odd\" format=\"appended\" offset=\"99\"/>"),
        ] {
            all.push(odd(what, format, plain.replace("</PointData>", &format!("{array}</PointData>")), true));
            let cells = format!("</PointData><CellData>{array}</CellData>");
            all.push(odd(format!("{what} of cells"), format, plain.replace("</PointData>", &cells), true));
            let field = format!("<FieldData>{array}</FieldData><Piece ");
            all.push(odd(format!("{what} of the file"), format, plain.replace("<Piece ", &field), false));
        }
    }
    all
}

fn ply(mesh: &TriMesh) -> Vec<Odd> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let file = |vertex: (&str, &str), face: (&str, &str), element: (&str, &str)| {
        let rows: String = points(mesh).lines().map(|line| format!("{line}{}\n", vertex.1)).collect();
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\n{}\
             element face {facets}\nproperty list uchar int vertex_indices\n{}{}end_header\n{rows}{}{}",
            vertex.0,
            face.0,
            element.0,
            faces(mesh, "3 ", 0, face.1),
            element.1
        )
    };
    let nothing = ("", "");
    let mut all = vec![
        odd("a half of a vertex", Format::Ply, file(("property half h\n", " 0.5"), nothing, nothing), true),
        odd("a list of vertices", Format::Ply, file(("property list uchar int n\n", " 2 7 8"), nothing, nothing), true),
        odd("a list of halves", Format::Ply, file(nothing, ("property list uchar half h\n", " 1 0.5"), nothing), true),
        odd("a label of faces", Format::Ply, file(nothing, ("property int label\n", " 7"), nothing), true),
        odd("words", Format::Ply, file(nothing, ("property string name\n", " steel"), nothing), true),
    ];
    for (what, header, rows) in [
        ("edges", "element edge 2\nproperty int vertex1\nproperty int vertex2\n", "0 1\n1 2\n"),
        ("materials", "element material 1\nproperty string name\nproperty list uchar half k\n", "steel 2 1.5 2\n"),
        ("an element of nothing", "element void 3\n", ""),
        ("very much of nothing", "element void 999999999999\n", ""),
    ] {
        all.push(odd(what, Format::Ply, file(nothing, nothing, (header, rows)), true));
    }
    // Behind the surface.
    let binary = encode(Format::Ply, mesh).unwrap();
    let at = binary.windows(10).position(|window| window == b"end_header").unwrap();
    let odd_element = b"element odd 2\nproperty half h\n";
    let bytes = [&binary[..at], odd_element, &binary[at..], &[1, 2, 3, 4]].concat();
    all.push(odd("binary halves behind the faces", Format::Ply, bytes, true));
    let whole = file(("property int64 id\n", " 7"), nothing, nothing);
    all.push(odd("numbers of 64 bits", Format::Ply, whole, false));
    all
}

fn gmsh(mesh: &TriMesh) -> Vec<Odd> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let nodes: String = (1..).zip(points(mesh).lines()).map(|(tag, line)| format!("{tag} {line}\n")).collect();
    let elements: String =
        (1..).zip(faces(mesh, "", 1, "").lines()).map(|(tag, line)| format!("{tag} 2 2 1 1 {line}\n")).collect();
    let file = |nodes: &str, more: &str, count: usize, odd: &str| {
        format!(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{nodes}{more}$Elements\n{}\n{elements}{odd}$EndElements\n",
            facets + count
        )
    };
    let plain = format!("$Nodes\n{vertices}\n{nodes}$EndNodes\n");
    let mut all = Vec::new();
    for (what, section, told) in [
        ("a comment", "$Comments\nanything $at all\n$EndComments\n", false),
        ("periodic nodes", "$Periodic\n1\n0 1 2\n1\n1 2\n$EndPeriodic\n", false),
        ("names", "$PhysicalNames\n1\n2 1 \"skin\"\n$EndPhysicalNames\n", false),
        ("broken names", "$PhysicalNames\n7\n2 1 \"skin\"\n$EndPhysicalNames\n", true),
        ("broken entities", "$Entities\n1 2\n$EndEntities\n", true),
        ("data of elements", "$ElementData\n1\n\"p\"\n1\n0\n3\n0\n1\n1\n1 5\n$EndElementData\n", true),
        ("vectors", "$NodeData\n1\n\"v\"\n1\n0\n3\n0\n3\n1\n1 0 0 0\n$EndNodeData\n", true),
        ("broken data", "$NodeData\nx\n$EndNodeData\n", true),
        ("too much data", "$NodeData\n1\n\"v\"\n1\n0\n3\n0\n1\n99999999\n1 0\n$EndNodeData\n", true),
    ] {
        all.push(odd(what, Format::Gmsh, file(&plain, section, 0, ""), told));
    }
    all.push(odd(
        "unknown elements",
        Format::Gmsh,
        file(&plain, "", 2, "9001 777 2 1 1 1 2 3\n9002 778 0 1 2\n"),
        true,
    ));
    // Each node has its place on a point, a curve, a surface or in a volume.
    let places = ["0 1", "1 1 0.5", "2 1 0.5 0.25", "3 1"];
    let placed: String = nodes.lines().enumerate().map(|(k, line)| format!("{line} {}\n", places[k % 4])).collect();
    let parametric = format!("$ParametricNodes\n{vertices}\n{placed}$EndParametricNodes\n");
    all.push(odd("parametric nodes", Format::Gmsh, file(&parametric, "", 0, ""), false));
    let placed: String = placed.lines().map(|line| format!("{}\n", line.split_once(' ').unwrap().1)).collect();
    assert_eq!(placed.lines().count(), vertices);
    let mut binary = b"$MeshFormat\n2.2 1 8\n".to_vec();
    binary.extend(1u32.to_le_bytes());
    binary.extend(format!("\n$EndMeshFormat\n$ParametricNodes\n{vertices}\n").into_bytes());
    for (tag, p) in (1u32..).zip(mesh.positions()) {
        binary.extend(tag.to_le_bytes());
        p.to_array().iter().for_each(|x| binary.extend(x.to_le_bytes()));
        let dimension = tag % 4;
        binary.extend(dimension.to_le_bytes());
        binary.extend(1u32.to_le_bytes());
        let numbers = if dimension == 3 { 0 } else { dimension };
        (0..numbers).for_each(|_| binary.extend(0.5f64.to_le_bytes()));
    }
    binary.extend(format!("\n$EndParametricNodes\n$Elements\n{facets}\n").into_bytes());
    [2, facets as u32, 2].iter().for_each(|n| binary.extend(n.to_le_bytes()));
    for (tag, facet) in (1u32..).zip(mesh.facets()) {
        [tag, 1, 1].iter().for_each(|n| binary.extend(n.to_le_bytes()));
        facet.iter().for_each(|v| binary.extend((v + 1).to_le_bytes()));
    }
    binary.extend(b"\n$EndElements\n");
    all.push(odd("parametric nodes, binary", Format::Gmsh, binary, false));
    // Version 4.1 with places in its blocks, and with a section of another program.
    let tags: String = (1..=vertices).map(|tag| format!("{tag}\n")).collect();
    let placed: String = points(mesh).lines().map(|line| format!("{line} 0.5 0.25\n")).collect();
    let lines: String =
        (1..).zip(faces(mesh, "", 1, "").lines()).map(|(tag, line)| format!("{tag} {line}\n")).collect();
    let four = format!(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Odd\n1 2 3\n$EndOdd\n$Nodes\n1 {vertices} 1 {vertices}\n2 1 1 {vertices}\n\
         {tags}{placed}$EndNodes\n$Elements\n2 {} 1 {}\n2 1 2 {facets}\n{lines}2 1 777 2\n1 1 2 3 4 5\n2 1 2\n$EndElements\n",
        facets + 2,
        facets + 2
    );
    all.push(odd("version 4.1", Format::Gmsh, four, true));
    all
}

fn medit(mesh: &TriMesh) -> Vec<Odd> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let rows: String = points(mesh).lines().map(|line| format!("{line} 0\n")).collect();
    let file = |more: &str| {
        format!(
            "MeshVersionFormatted 2\nDimension 3\nVertices\n{vertices}\n{rows}{more}Triangles\n{facets}\n{}End\n",
            faces(mesh, "", 1, " 7")
        )
    };
    [
        ("corners", "Corners\n2\n1\n2\n", true),
        ("no corners", "Corners\n0\n", false),
        ("normals", "Normals\n1\n0 0 1\nNormalAtVertices\n1\n1 1\n", true),
        ("an unknown keyword", "Colours\n3\nred green blue\n", true),
        ("edges", "Edges\n1\n1 2 0\n", true),
        ("edges that are ridges", "Edges\n1\n1 2 0\nRidges\n1\n1\n", false),
        ("too many edges", "Edges\n1000000\n1 2 0\n", true),
        ("edges without numbers", "Edges\nmany\n", true),
        ("ridges of nothing", "Ridges\n2\n1\n77\n", true),
        ("an edge that is none", "Edges\n1\n1 1 0\nRequiredEdges\n1\n1\n", true),
        ("required vertices", "RequiredVertices\n2\n1\n2\n", false),
        ("required vertices that are not there", "RequiredVertices\n2\n1\n9999\n", true),
        ("required vertices without numbers", "RequiredVertices\nmany\n", true),
        ("an edge of no vertices", "Edges\n1\n-4 99999999999 0\nRidges\n1\n1\n", true),
    ]
    .into_iter()
    .map(|(what, more, told)| odd(what, Format::Medit, file(more), told))
    .collect()
}

fn gltf(mesh: &TriMesh) -> Vec<Odd> {
    let plain = String::from_utf8(encode(Format::Gltf, mesh).unwrap()).unwrap();
    let accessor = |text: &str| {
        plain
            .replace("\"accessors\":[", &format!("\"accessors\":[{text},"))
            // The others have other numbers then.
            .replace("\"POSITION\":0", "\"POSITION\":1")
            .replace("\"indices\":1", "\"indices\":2")
    };
    let mut all = Vec::new();
    for text in [
        "{}",
        "{\"componentType\":\"float\",\"count\":-1,\"type\":\"MAT7\"}",
        "{\"componentType\":5126,\"count\":1.5e9,\"type\":\"VEC3\",\"bufferView\":[0]}",
        "{\"componentType\":5126,\"count\":{\"a\":[1,null]},\"type\":\"VEC3\",\"byteOffset\":null}",
    ] {
        all.push(odd(format!("an accessor {text}"), Format::Gltf, accessor(text), false));
        let coloured =
            accessor(text).replace("\"POSITION\":1", "\"POSITION\":1,\"COLOR_0\":0,\"NORMAL\":0,\"TEXCOORD_0\":0");
        all.push(odd(format!("colours {text}"), Format::Gltf, coloured, true));
    }
    let with = |from: &str, to: &str| {
        assert!(plain.contains(from), "{from}");
        plain.replace(from, to)
    };
    let attribute = |text: &str| with("\"POSITION\":0", &format!("\"POSITION\":0,{text}"));
    all.push(odd("a name for an accessor", Format::Gltf, attribute("\"COLOR_0\":\"red\",\"_ID\":{}"), true));
    all.push(odd("no accessor", Format::Gltf, attribute("\"NORMAL\":99"), true));
    let image = "\"buffers\":[{\"byteLength\":5,\"uri\":\"photo.bin\"},";
    let moved = with("\"buffers\":[", image).replace("\"buffer\":0", "\"buffer\":1");
    all.push(odd("a buffer of an image", Format::Gltf, moved, false));
    all.push(odd("a skin that is not there", Format::Gltf, with("{\"mesh\":0}", "{\"mesh\":0,\"skin\":4}"), true));
    let morphed = with("\"mode\":4", "\"mode\":4,\"targets\":[{\"POSITION\":99}]");
    all.push(odd("morph targets", Format::Gltf, morphed, true));
    let used = |names: &str| with("{\"asset\"", &format!("{{\"extensionsUsed\":[{names}],\"asset\""));
    all.push(odd(
        "materials of an extension",
        Format::Gltf,
        used("\"KHR_materials_unlit\",\"KHR_texture_basisu\""),
        false,
    ));
    all.push(odd("instances", Format::Gltf, used("\"KHR_materials_unlit\",\"EXT_mesh_gpu_instancing\""), true));
    let animated = with("{\"asset\"", "{\"animations\":[{\"samplers\":[{\"input\":77}]}],\"materials\":[{}],\"asset\"");
    all.push(odd("animations", Format::Gltf, animated, false));
    all
}

fn others(mesh: &TriMesh) -> Vec<Odd> {
    let mut all = Vec::new();
    let obj = String::from_utf8(encode(Format::Obj, mesh).unwrap()).unwrap();
    for line in ["mtllib none.mtl", "vp 1 2", "s off", "csh -x", "lod 3", "# f 1 2 99"] {
        all.push(odd(line, Format::Obj, format!("{line}\n{obj}{line}\n"), false));
    }
    for line in ["l 1 2 3", "p 4", "curv 0 1 1 2", "surf 0 1 0 1 1 2 3 4"] {
        all.push(odd(line, Format::Obj, format!("{obj}{line}\n"), true));
    }
    let rows: Vec<&str> = obj.lines().collect();
    let each = |change: &dyn Fn(usize, &str) -> String| -> String {
        rows.iter().enumerate().map(|(k, row)| change(k, row) + "\n").collect()
    };
    let coloured = |every: usize, light: &str| {
        each(&|k, row| {
            if row.starts_with("v ") && k % every == 0 { format!("{row} {light}") } else { (*row).to_owned() }
        })
    };
    let textured = |every: usize, point: &str| {
        let corners = |row: &str| row.replace(' ', "/1 ") + "/1";
        let faces = each(&|k, row| match row.strip_prefix("f ") {
            Some(face) if k % every == 0 => format!("f {}", corners(face)),
            _ => row.to_owned(),
        });
        format!("{faces}{point}\n")
    };
    all.push(odd("colours", Format::Obj, coloured(1, "1 0.5 0"), false));
    all.push(odd("colours of some vertices", Format::Obj, coloured(2, "1 0.5 0"), true));
    all.push(odd("texture", Format::Obj, textured(1, "vt 0 0 0"), false));
    all.push(odd("texture of some facets", Format::Obj, textured(2, "vt 0 0"), true));
    all.push(odd("texture in space", Format::Obj, textured(1, "vt 0 0 0.5"), true));
    let stl = encode(Format::Stl, mesh).unwrap();
    let marked = |mark: &dyn Fn(usize) -> u16, head: &[u8]| {
        let mut bytes = stl.clone();
        bytes[..head.len()].copy_from_slice(head);
        for (facet, record) in bytes[84..].chunks_exact_mut(50).enumerate() {
            record[48..].copy_from_slice(&mark(facet).to_le_bytes());
        }
        bytes
    };
    all.push(odd("one mark", Format::Stl, marked(&|_| 0x8000, b"any"), false));
    all.push(odd("colours of facets", Format::Stl, marked(&|facet| 0x8000 | u16::from(facet < 20), b"any"), false));
    all.push(odd("a colour in the header", Format::Stl, marked(&|_| 0, b"COLOR=\xff\0\0\xff"), true));
    let off = |kind: &str, more: &str, face: &str| {
        let rows: String = points(mesh).lines().map(|line| format!("{line}{more}\n")).collect();
        let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
        format!("{kind}OFF\n{vertices} {facets} 0\n{rows}{}", faces(mesh, "3 ", 0, face))
    };
    for (what, kind, more, face, told) in [
        ("colours", "C", " 255 0 0 255", "", false),
        ("colours without opacity", "C", " 255 0 0", "", false),
        ("colours that are not announced", "", " 255 0 0", "", true),
        ("more than colours", "C", " 255 0 0 255 7", "", true),
        ("colours of faces", "", "", " 255 0 0", true),
        ("an index of a colour", "", "", " 3", true),
    ] {
        all.push(odd(what, Format::Off, off(kind, more, face), told));
    }
    let model = |resources: &str, object: &str| {
        let mut text = String::from(
            "<?xml version=\"1.0\"?><model unit=\"millimeter\" xmlns:m=\"colours\"><metadata name=\"Title\">a &amp; b</metadata><resources>",
        );
        let _ = write!(text, "{resources}<object id=\"7\" pid=\"1\"><mesh><vertices>");
        mesh.positions().iter().for_each(|p| {
            let _ = write!(text, "<vertex x=\"{:?}\" y=\"{:?}\" z=\"{:?}\"/>", p.x, p.y, p.z);
        });
        text.push_str("</vertices><triangles>");
        mesh.facets().iter().for_each(|[a, b, c]| {
            let _ = write!(text, "<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\" pid=\"1\" p1=\"0\"/>");
        });
        let _ = write!(
            text,
            "</triangles>{object}</mesh></object></resources><build><item objectid=\"7\"/></build></model>"
        );
        crate::packages::stored(&[("3D/3dmodel.model", &text)])
    };
    let materials = "<basematerials id=\"1\"><base name=\"a\" displaycolor=\"#FF0000FF\"/></basematerials>";
    let colours = "<m:colorgroup id=\"1\"><m:color color=\"#FF0000\"/></m:colorgroup>";
    for (what, resources, object, told) in [
        ("nothing", "", "", false),
        ("materials", materials, "", true),
        ("colours", colours, "", true),
        (
            "beams",
            "",
            "<b:beamlattice radius=\"1\"><b:beams><b:beam v1=\"0\" v2=\"1\"/></b:beams></b:beamlattice>",
            true,
        ),
        (
            "sets of triangles",
            "",
            "<t:trianglesets><t:triangleset name=\"a\"><t:ref index=\"0\"/></t:triangleset></t:trianglesets>",
            false,
        ),
    ] {
        all.push(odd(what, Format::ThreeMf, model(resources, object), told));
    }
    all
}

#[test]
fn odd_parts_refuse_no_file() {
    let mesh = Shape::Torus.build(60);
    let all = [legacy_vtk, xml_vtk, ply, gmsh, medit, gltf, others].into_iter().flat_map(|odd| odd(&mesh));
    let mut wrong = Vec::new();
    for Odd { what, format, bytes, told } in all {
        let expected = decode(format, &encode(format, &mesh).unwrap()).unwrap();
        match decode_with_attributes(format, &bytes) {
            Err(error) => wrong.push(format!("{format:?}, {what}: {error}")),
            Ok(Loaded { mesh, left_aside, .. }) => {
                if mesh != expected {
                    wrong.push(format!("{format:?}, {what}: another surface"));
                }
                if left_aside.is_empty() == told {
                    wrong.push(format!("{format:?}, {what}: {left_aside:?}"));
                }
            }
        }
        crate::readers::check(format, &bytes).unwrap_or_else(|text| wrong.push(format!("{format:?}, {what}: {text}")));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What a file requires is read, or the file is refused.
#[test]
fn required_extensions_are_read_or_refuse_a_file() {
    let mesh = Shape::Torus.build(60);
    let gltf = String::from_utf8(encode(Format::Gltf, &mesh).unwrap()).unwrap();
    for (name, is_read) in [
        ("KHR_materials_unlit", true),
        ("KHR_mesh_quantization", true),
        ("EXT_mesh_gpu_instancing", false),
        ("KHR_draco_mesh_compression", false),
        ("ACME_anything", false),
    ] {
        let text = gltf.replace("{\"asset\"", &format!("{{\"extensionsRequired\":[\"{name}\"],\"asset\""));
        let read = decode(Format::Gltf, text.as_bytes());
        assert_eq!(read.is_ok(), is_read, "{name}: {read:?}");
        assert!(is_read || read.unwrap_err().to_string().contains(name));
    }
    let model = |attributes: &str| {
        let text = format!(
            "<model unit=\"millimeter\" {attributes}><resources><object id=\"7\"><mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/>\
             <vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles>\
             <triangle v1=\"0\" v2=\"1\" v3=\"2\"/></triangles></mesh></object></resources><build><item objectid=\"7\"/></build></model>"
        );
        crate::packages::stored(&[("3D/3dmodel.model", &text)])
    };
    for (attributes, is_read) in [
        ("", true),
        ("requiredextensions=\"\"", true),
        ("xmlns:m=\"http://schemas.microsoft.com/3dmanufacturing/material/2015/02\" requiredextensions=\"m\"", true),
        ("xmlns:x=\"http://acme.example/2020\" requiredextensions=\"x\"", false),
        ("requiredextensions=\"y\"", false),
    ] {
        let read = decode(Format::ThreeMf, &model(attributes));
        assert_eq!(read.is_ok(), is_read, "{attributes}: {read:?}");
    }
}

/// Names of scalars are kept where a format can hold them.
#[test]
fn names_of_scalars_are_text() {
    let mesh = Shape::Torus.build(60);
    let mut attributes = Attributes::new(&mesh);
    let names = ["von Mises (MPa)", "Température", "50 %", "a<b & \"c\"", "1st"];
    for name in names {
        let values = (0..mesh.positions().len()).map(|k| k as f64).collect();
        attributes.add_scalar(Scalar::new(name, values)).unwrap();
    }
    for (format, are_kept) in
        [(Format::Vtk, true), (Format::Vtp, true), (Format::Vtu, true), (Format::Gmsh, false), (Format::Ply, false)]
    {
        let (bytes, left_out) = encode_with_attributes(format, &mesh, &attributes).unwrap();
        let loaded = decode_with_attributes(format, &bytes).unwrap();
        let read: Vec<&str> = loaded.attributes.scalars().iter().map(|scalar| scalar.name.as_str()).collect();
        assert_eq!(read.len(), names.len(), "{format:?}: {:?}", loaded.left_aside);
        assert_eq!(read == names, are_kept, "{format:?}: {read:?}");
        assert_eq!(left_out.is_empty(), are_kept, "{format:?}: {left_out:?}");
    }
}

/// Lists of odd arrays have an end.
#[test]
fn lines_have_an_end() {
    let array = "odd 1 0 int\n".repeat(5000);
    let text = format!(
        "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 3 int\n0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2\n\
         CELL_DATA 0\nFIELD a 5000\n{array}"
    );
    let lines = decode_with_attributes(Format::Vtk, text.as_bytes()).unwrap().left_aside;
    assert_eq!(lines.len(), 1025);
    assert!(lines[1024].to_string().contains("3976 more"), "{}", lines[1024]);
}

/// Labels of facets that a format has are regions, once there are several; if they are not wanted, and of vertices, they are told.
#[test]
fn labels_of_facets_are_regions_or_told() {
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let facet = |z: u32| {
        format!("facet normal 0 0 1\nouter loop\nvertex 0 0 {z}\nvertex 1 0 {z}\nvertex 0 1 {z}\nendloop\nendfacet\n")
    };
    let medit = |one: u32, other: u32| {
        format!(
            "MeshVersionFormatted 2\nDimension 3\nVertices 4\n0 0 0 0\n1 0 0 0\n1 1 0 0\n0 1 0 0\nTriangles 2\n1 2 3 {one}\n1 3 4 {other}\nEnd\n"
        )
    };
    let gmsh = |one: u32, other: u32| {
        format!(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n$EndNodes\n$Elements\n2\n\
             1 2 2 {one} 1 1 2 3\n2 2 2 {other} 1 1 3 4\n$EndElements\n"
        )
    };
    for (format, text, told) in [
        (Format::Obj, format!("{square}usemtl a\nf 1 2 3\nf 1 3 4\n"), None),
        (Format::Obj, format!("{square}usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\nusemtl a\n"), Some("2 materials")),
        (Format::Obj, format!("{square}f 1 2 3\nusemtl b\nf 1 3 4\n"), Some("2 materials")),
        (Format::Obj, format!("{square}o one\nf 1 2 3\ng two\nf 1 3 4\ng empty\n"), Some("2 groups")),
        (Format::Stl, format!("solid a\n{}endsolid a\n", facet(0)), None),
        (Format::Stl, format!("solid a\n{}endsolid a\nsolid b\n{}endsolid b\n", facet(0), facet(1)), Some("2 solids")),
        (Format::Medit, medit(1, 1), None),
        (Format::Medit, medit(1, 7), Some("2 references")),
        (Format::Medit, medit(1, 1).replace("1 0 0 0", "1 0 0 5"), Some("2 references of vertices")),
        (Format::Gmsh, gmsh(1, 1), None),
        (Format::Gmsh, gmsh(1, 7), Some("2 physical groups")),
        (Format::Gmsh, gmsh(1, 1).replace("2 2 2 1 1", "2 2 2 1 5"), Some("2 parts of the model")),
    ] {
        let ignored = decode_with_regions(format, text.as_bytes(), &RegionChoice::Ignore).unwrap();
        let said: Vec<String> = ignored.left_aside.iter().map(ToString::to_string).collect();
        assert_eq!(said.len(), usize::from(told.is_some()), "{text}: {said:?}");
        assert!(told.is_none_or(|told| said[0].starts_with(told)), "{text}: {said:?}");
        let loaded = decode_with_attributes(format, text.as_bytes()).unwrap();
        let of_vertices = told.is_some_and(|told| told.ends_with("vertices"));
        assert_eq!(loaded.left_aside.len(), usize::from(of_vertices), "{text}");
        let regions = loaded.attributes.regions().map_or(0, |regions| regions.all().len());
        assert_eq!(regions, if told.is_some() && !of_vertices { 2 } else { 0 }, "{text}");
    }
}
