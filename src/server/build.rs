//! The page's files are embedded: a new one must be noticed.

fn main() {
    println!("cargo::rerun-if-changed=../../ui/dist");
}
