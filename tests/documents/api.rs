//! `docs/api.md` is made of the comments in `proto/`. `TESSERA_BLESS=1` writes the page instead of comparing it.

use std::collections::BTreeMap;
use std::fmt::Write;

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    ServiceDescriptorProto,
};

use super::{place, read};

const PAGE: &str = "docs/api.md";
/// Those that most callers need come first.
const FILES: [&str; 4] = ["remesh", "job", "blob", "server"];
const HEAD: &str = "# API reference

This page is generated from the comments in `proto/tessera/v1`. To change it, change a comment and run
`TESSERA_BLESS=1 cargo test --test documents api`.

[The service](service.md) explains the calls and [Compatibility](compatibility.md) what may change. All messages are in the package
`tessera.v1`. A field marked *optional* tells \"not set\" apart from 0.
";

// Numbers of fields in descriptor.proto, of which a comment's path is made.
const SYNTAX: i32 = 12;
const MESSAGE: i32 = 4;
const ENUM: i32 = 5;
const SERVICE: i32 = 6;
const PART: i32 = 2;
const ONEOF: i32 = 8;

/// What a file says, by the path of the thing that it is said of.
struct Comments(BTreeMap<Vec<i32>, String>);

impl Comments {
    fn of(file: &FileDescriptorProto) -> Self {
        let places = &file.source_code_info.as_ref().expect("comments are kept").location;
        Self(places.iter().map(|place| (place.path.clone(), place.leading_comments().to_owned())).collect())
    }

    /// As paragraphs and lists.
    fn text(&self, path: &[i32]) -> String {
        let raw = self.0.get(path).map_or("", String::as_str);
        raw.lines().map(|line| line.strip_prefix(' ').unwrap_or(line)).collect::<Vec<_>>().join("\n").trim().to_owned()
    }

    /// In one line, for a table.
    fn line(&self, path: &[i32]) -> String {
        let text = self.text(path);
        assert!(!text.is_empty(), "nothing is said of {path:?}");
        text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
    }
}

fn link(full: &str) -> String {
    match full.strip_prefix(".tessera.v1.") {
        Some(name) => format!("[`{name}`](#{})", name.to_lowercase()),
        None => format!("`{}`", full.trim_start_matches('.')),
    }
}

/// The type of a field, as the interface says it.
fn kind(field: &FieldDescriptorProto, message: &DescriptorProto) -> String {
    let scalar = match field.r#type() {
        Type::Double => "double",
        Type::Int64 => "int64",
        Type::Uint64 => "uint64",
        Type::Int32 => "int32",
        Type::Uint32 => "uint32",
        Type::Fixed32 => "fixed32",
        Type::Bool => "bool",
        Type::String => "string",
        Type::Bytes => "bytes",
        Type::Message | Type::Enum => "",
        other => panic!("{} is of type {other:?}, which this page does not know", field.name()),
    };
    if let Some(entry) =
        message.nested_type.iter().find(|entry| field.type_name().ends_with(&format!(".{}", entry.name())))
    {
        let parts: Vec<String> = entry.field.iter().map(|part| kind(part, entry).replace('`', "")).collect();
        return format!("`map<{}>`", parts.join(", "));
    }
    let plain = if scalar.is_empty() { link(field.type_name()) } else { format!("`{scalar}`") };
    match (field.label(), field.proto3_optional()) {
        (Label::Repeated, _) => format!("repeated {plain}"),
        (_, true) => format!("optional {plain}"),
        _ => plain,
    }
}

fn service(out: &mut String, service: &ServiceDescriptorProto, path: &[i32], said: &Comments) {
    writeln!(out, "\n### {}\n\n{}", service.name(), said.text(path)).unwrap();
    for (at, method) in service.method.iter().enumerate() {
        let path = [path, &[PART, at as i32]].concat();
        let side = |full: &str, many: bool| format!("{}{}", if many { "stream of " } else { "" }, link(full));
        let asked = side(method.input_type(), method.client_streaming());
        let answered = side(method.output_type(), method.server_streaming());
        writeln!(out, "\n#### {}.{}\n\n{asked} → {answered}\n", service.name(), method.name()).unwrap();
        writeln!(out, "{}", said.text(&path)).unwrap();
    }
}

fn message(out: &mut String, message: &DescriptorProto, path: &[i32], said: &Comments) {
    writeln!(out, "\n### {}\n\n{}", message.name(), said.text(path)).unwrap();
    for (at, one) in message.oneof_decl.iter().enumerate() {
        // A field that is `optional` has a choice of its own, of which nothing is said.
        let about = said.text(&[path, &[ONEOF, at as i32]].concat());
        if !about.is_empty() {
            let about = about.split_whitespace().collect::<Vec<_>>().join(" ");
            writeln!(out, "\nOf `{}`: {}{}", one.name(), about[..1].to_lowercase(), &about[1..]).unwrap();
        }
    }
    if message.field.is_empty() {
        return;
    }
    out.push_str("\n| field | number | type | meaning |\n| --- | --- | --- | --- |\n");
    for (at, field) in message.field.iter().enumerate() {
        let about = said.line(&[path, &[PART, at as i32]].concat());
        let choice =
            field.oneof_index.filter(|_| !field.proto3_optional()).map(|one| &message.oneof_decl[one as usize]);
        let choice = choice.map_or(String::new(), |one| format!(" (of `{}`)", one.name()));
        let kind = kind(field, message);
        writeln!(out, "| `{}` | {} | {kind}{choice} | {about} |", field.name(), field.number()).unwrap();
    }
}

fn choices(out: &mut String, choices: &EnumDescriptorProto, path: &[i32], said: &Comments) {
    writeln!(out, "\n### {}\n\n{}\n", choices.name(), said.text(path)).unwrap();
    out.push_str("| value | number | meaning |\n| --- | --- | --- |\n");
    for (at, value) in choices.value.iter().enumerate() {
        let about = said.line(&[path, &[PART, at as i32]].concat());
        writeln!(out, "| `{}` | {} | {about} |", value.name(), value.number()).unwrap();
    }
}

fn page() -> String {
    let files = FileDescriptorSet::decode(tessera::proto::DESCRIPTORS).unwrap().file;
    let mut out = HEAD.to_owned();
    for name in FILES {
        let file = files.iter().find(|file| file.name().ends_with(&format!("/{name}.proto"))).unwrap();
        let said = Comments::of(file);
        writeln!(out, "\n## {name}.proto\n\n{}", said.text(&[SYNTAX])).unwrap();
        for (at, one) in file.service.iter().enumerate() {
            service(&mut out, one, &[SERVICE, at as i32], &said);
        }
        for (at, one) in file.message_type.iter().enumerate() {
            message(&mut out, one, &[MESSAGE, at as i32], &said);
        }
        for (at, one) in file.enum_type.iter().enumerate() {
            choices(&mut out, one, &[ENUM, at as i32], &said);
        }
    }
    out
}

#[test]
fn the_page_is_what_proto_says() {
    let made = page();
    if std::env::var_os("TESSERA_BLESS").is_some() {
        std::fs::write(place(PAGE), made).unwrap();
        return;
    }
    let there = read(PAGE);
    let (made, there): (Vec<&str>, Vec<&str>) = (made.lines().collect(), there.lines().collect());
    let first = made.iter().zip(&there).position(|(a, b)| a != b).unwrap_or(made.len().min(there.len()));
    let line = |page: &[&str]| page.get(first).map_or("nothing", |line| line).to_owned();
    assert!(
        made == there,
        "{PAGE} is not what proto/ says; TESSERA_BLESS=1 writes it anew\nline {}, of proto/: {}\non the page: {}",
        first + 1,
        line(&made),
        line(&there),
    );
}

/// Whoever adds a file to the interface adds it to the page.
#[test]
fn every_file_is_on_the_page() {
    let there = std::fs::read_dir(place("proto/tessera/v1")).unwrap();
    let mut names: Vec<String> =
        there.map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned()).collect();
    names.sort();
    let mut known = FILES;
    known.sort_unstable();
    assert_eq!(names, known);
}
