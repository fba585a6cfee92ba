//! Looks at what this machine has for tests.
//!
//! Only this crate and the tests are compiled again when it changes, since the library does not depend on it.

use std::env;
use std::path::{Path, PathBuf};

/// Where the Vulkan loader of Linux looks for drivers.
const DRIVERS: [&str; 3] = ["/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/usr/share/vulkan/icd.d"];

/// Why tests of a GPU cannot run here, as far as can be told without opening one.
fn missing_gpu() -> Option<&'static str> {
    for variable in ["TESSERA_TEST_GPU", "VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        println!("cargo::rerun-if-env-changed={variable}");
    }
    match env::var("TESSERA_TEST_GPU").as_deref() {
        Ok("off") => return Some("TESSERA_TEST_GPU is off"),
        Ok("required") => return None,
        _ => {}
    }
    let is_linux = env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux");
    let named = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].iter().any(|variable| env::var_os(variable).is_some());
    let folders: Vec<&Path> = DRIVERS.iter().map(Path::new).filter(|folder| folder.is_dir()).collect();
    for folder in &folders {
        println!("cargo::rerun-if-changed={}", folder.display());
    }
    let has_drivers = |folder: &&Path| folder.read_dir().is_ok_and(|mut files| files.next().is_some());
    let none = is_linux && !named && !folders.iter().any(has_drivers);
    none.then_some("there is no Vulkan driver here (Debian: mesa-vulkan-drivers)")
}

/// Whether a variable names a folder.
fn is_folder(variable: &str) -> bool {
    println!("cargo::rerun-if-env-changed={variable}");
    env::var_os(variable).map(PathBuf::from).is_some_and(|folder| !folder.as_os_str().is_empty())
}

/// Why tests of PostgreSQL cannot run here.
fn missing_postgres() -> Option<&'static str> {
    println!("cargo::rerun-if-env-changed=TESSERA_TEST_POSTGRES");
    println!("cargo::rerun-if-env-changed=PATH");
    match env::var("TESSERA_TEST_POSTGRES").as_deref() {
        Ok("off") => return Some("TESSERA_TEST_POSTGRES is off"),
        Ok("required") => return None,
        _ => {}
    }
    let debian = Path::new("/usr/lib/postgresql");
    println!("cargo::rerun-if-changed={}", debian.display());
    let path = env::var_os("PATH").unwrap_or_default();
    let in_path = env::split_paths(&path).any(|folder| folder.join("initdb").is_file());
    let by_debian = debian.read_dir().is_ok_and(|mut versions| versions.any(|version| version.is_ok()));
    (!in_path && !by_debian).then_some("PostgreSQL is not installed here (Debian: postgresql)")
}

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-env=NEEDS_POSTGRES={}", missing_postgres().unwrap_or_default());
    println!("cargo::rustc-env=NEEDS_GPU={}", missing_gpu().unwrap_or_default());
    for (name, variable, what) in [("MESHES", "TESSERA_MESHES", "real meshes"), ("SEEDS", "TESSERA_SEEDS", "seed sets")]
    {
        let why = match is_folder(variable) {
            true => String::new(),
            false => format!("{variable} names no folder with {what}"),
        };
        println!("cargo::rustc-env=NEEDS_{name}={why}");
    }
}
