//! `--picture` writes a PNG of the wished size, and refuses what it cannot before any work.

use std::path::Path;
use std::process::{Command, Output};

use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

fn tessera(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.current_dir(folder).args(line.split(' ')).env("TESSERA_BACKEND", "parallel").output().unwrap()
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Sphere.build(1000)).unwrap();
    folder
}

/// Width, height and pixels.
fn read(path: &Path) -> (u32, u32, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    (info.width, info.height, pixels)
}

/// How many colours there are.
fn colours(pixels: &[u8]) -> usize {
    let mut all: Vec<&[u8]> = pixels.chunks(3).collect();
    all.sort_unstable();
    all.dedup();
    all.len()
}

#[test]
fn a_remesh_and_a_diagram_are_drawn() {
    let folder = folder();
    let runs = [
        ("remesh in.ply -o out.ply --points 200 --picture", "plain.png", "--picture-size 320x200"),
        ("remesh in.ply -o out.ply --points 200 --picture", "quality.png", "--picture-size 320x200 --colour quality"),
        ("remesh in.ply -o out.ply --points 200 --picture", "cell.png", "--picture-size 320x200 --color cell"),
        ("remesh in.ply -o out.ply --points 200 --picture", "region.png", "--picture-size 320x200 --colour region"),
        ("measure in.ply --picture", "before.png", "--picture-size 320x200"),
        ("measure in.ply out.ply --picture", "after.png", "--picture-size 320x200 --colour quality"),
        ("rvd in.ply --points 200 --picture", "cells.PNG", "--picture-size 320x200"),
        ("rvd in.ply --points 200 --dots --picture", "dots.png", "--picture-size 320x200 --view -1,0,0 --up 0,0,1"),
        ("rvd in.ply --points 200 -o cells.ply --picture", "both.png", "--picture-size 320x200 --colour plain"),
    ];
    for (line, name, options) in runs {
        let out = tessera(folder.path(), &format!("{line} {name} {options}"));
        assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
        let (width, height, pixels) = read(&folder.path().join(name));
        assert_eq!((width, height), (320, 200), "{name}");
        assert!(colours(&pixels) > 50, "{name} is nearly empty");
        assert_eq!(pixels[..3], [255; 3], "{name}: the corner is background");
    }
    assert!(folder.path().join("cells.ply").exists());
}

#[test]
fn the_default_size_and_the_same_bytes_again() {
    let folder = folder();
    for (name, threads) in [("one.png", 1), ("two.png", 3)] {
        let out = tessera(folder.path(), &format!("rvd in.ply --points 50 --threads {threads} --picture {name}"));
        assert!(out.status.success());
    }
    let (width, height, _) = read(&folder.path().join("one.png"));
    assert_eq!((width, height), (1600, 1200));
    let [one, two] = ["one.png", "two.png"].map(|name| std::fs::read(folder.path().join(name)).unwrap());
    assert!(one == two);
}

#[test]
fn a_wrong_option_is_refused_before_any_work() {
    let folder = folder();
    let remesh = "remesh nowhere.ply -o out.ply --points 20";
    let rvd = "rvd nowhere.ply --points 20";
    for line in [
        format!("{remesh} --picture out.jpg"),
        format!("{remesh} --picture out"),
        format!("{remesh} --picture no/such/folder/out.png"),
        format!("{remesh} --picture out.png --view 0,0,0"),
        format!("{remesh} --picture out.png --view 1,2"),
        format!("{remesh} --picture out.png --picture-size 0x10"),
        format!("{remesh} --picture out.png --colour red"),
        format!("{remesh} --colour quality"),
        format!("{rvd} --picture out.ply"),
        format!("{rvd} --picture out.png --colour quality"),
        format!("{rvd} --picture out.png --dots --endpoint http://127.0.0.1:9"),
        format!("{rvd} --dots"),
    ] {
        // The input is not there either: had it been looked for first, the code would be 66.
        let out = tessera(folder.path(), &line);
        let code = if line.contains("folder") { 73 } else { 2 };
        assert_eq!(out.status.code(), Some(code), "{line}: {}", String::from_utf8_lossy(&out.stderr));
        assert!(!folder.path().join("out.ply").exists());
    }
    let out = tessera(folder.path(), &format!("{remesh} --picture out.png"));
    assert_eq!(out.status.code(), Some(66));
}
