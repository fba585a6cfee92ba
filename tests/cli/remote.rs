//! Promise: work on a server is told and written as work here is, and a server listens where it is told to by name.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

use crate::process::address_of;

/// A server of its own, which ends with the test.
struct Server(Child, String);

impl Server {
    fn start(listen: &str) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
        command.args(["serve", "--ephemeral", "--backend", "parallel", "--listen", listen]).env("TESSERA_LOG", "error");
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let address = address_of(&mut child);
        Self(child, address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn tessera(folder: &Path, line: &str) -> (String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env("TESSERA_BACKEND", "parallel").env("TESSERA_PROGRESS_S", "0.03").current_dir(folder);
    let out = command.args(line.split(' ')).output().unwrap();
    let told = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{line}: {told}");
    (String::from_utf8(out.stdout).unwrap(), told)
}

/// Lines of a summary but what the machine and the moment decide.
fn figures(summary: &str) -> Vec<&str> {
    summary.lines().filter(|line| !["backend", "memory", "time"].iter().any(|word| line.starts_with(word))).collect()
}

#[test]
fn a_server_s_work_is_told_as_one_s_own() {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Torus.build(2000)).unwrap();
    let server = Server::start("localhost:0");
    assert!(server.1.starts_with("127.0.0.1:"), "{}", server.1);
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();

    // All options as they are by themselves, but for steps enough to see them.
    for options in ["", " --lloyd 100", " --max-deviation 1.5"] {
        let line = format!("remesh in.ply -o out.ply --points 300{options}");
        let (here, _) = tessera(folder.path(), &line);
        let mine = read("out.ply");
        let (there, told) = tessera(folder.path(), &format!("{line} --endpoint http://{}", server.1));
        assert_eq!(read("out.ply"), mine, "{line}");
        assert_eq!(figures(&there), figures(&here), "{line}");
        assert!(there.contains(&format!("at http://{}", server.1)), "{there}");
        assert!(there.contains("of it at work on the server"), "{there}");
        if options.contains("100") {
            let lines: Vec<&str> = told.lines().filter(|l| l.starts_with("tessera: in.ply: ")).collect();
            assert!(lines.iter().any(|l| l.contains("iterations")), "{told}");
        }
    }
    let line = "rvd in.ply --points 50% -o cells.ply";
    let ((here, _), mine) = (tessera(folder.path(), line), read("cells.ply"));
    let (there, _) =
        tessera(folder.path(), &format!("{line} --endpoint http://localhost:{}", server.1.rsplit(':').next().unwrap()));
    assert_eq!(read("cells.ply"), mine);
    let head = |text: &str| text.split(", by").next().unwrap().to_owned();
    assert_eq!(head(&there), head(&here));
}
