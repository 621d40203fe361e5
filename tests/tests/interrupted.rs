//! A run that is interrupted, at any moment, leaves no output or the previous one, and no temporary file (invariant 8
//! of the design).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use vdt_tests::program::{Workplace, wait};
use vdt_tests::workplace;

/// Everything in a folder.
type Contents = BTreeMap<PathBuf, Vec<u8>>;

/// The commands that write, with their outputs.
const COMMANDS: [(&str, &str); 3] = [
    ("generate terrain --triangles 300000 --force -o", "out.ply"),
    ("build mesh.ply --force -o", "out.vdt"),
    ("extract model.vdt --error 0 --force -o", "out.ply"),
];

fn place_with_terrain() -> Workplace {
    let place = workplace!();
    place.json("generate terrain --triangles 60000 -o mesh.ply");
    place.json("build mesh.ply -o model.vdt");
    place
}

/// Starts the command, and sends it this signal after a while. True if that came before its end.
fn interrupt(place: &Workplace, arguments: &str, signal: &str, after: Duration) -> bool {
    let words: Vec<&str> = arguments.split_whitespace().collect();
    let mut command = place.command(&words);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(after);
    // Nobody has waited for it yet, so the number is its own still.
    let sent = Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let outcome = wait(child, arguments, |_| ());
    if outcome.status.success() {
        return false;
    }
    match signal {
        "KILL" => assert_eq!(outcome.status.signal(), Some(9), "{outcome:?}"),
        // Before it has begun to listen, the signal itself is the end; after that, it says so.
        _ => {
            let by_signal = outcome.status.signal().is_some();
            let by_itself = outcome.status.code() == Some(130) && outcome.stderr == "vdt: interrupted\n";
            assert!(by_signal || by_itself, "{outcome:?}");
        }
    }
    true
}

/// Interrupts each command at many moments; of each, `judge` is told the command, its output, and the files before, and
/// after had it come to its end.
fn interrupt_often(signals: &[&str], judge: impl Fn(&Workplace, &str, &str, &Contents, &Contents)) {
    let place = place_with_terrain();
    for (command, output) in COMMANDS {
        let arguments = format!("{command} {output}");
        let start = Instant::now();
        place.run(&arguments).success();
        // The moments lie all over the time that the command takes, on this machine.
        let step_time = start.elapsed() / 40;
        let whole = place.read(output);
        let mut interrupted = 0;
        for step in 0..40_u64 {
            std::fs::remove_file(place.path(output)).unwrap();
            if step % 4 < 2 {
                place.write(output, "precious");
            }
            let before = place.contents();
            let mut done = before.clone();
            done.insert(output.into(), whole.clone());
            let signal = signals[step as usize % signals.len()];
            if interrupt(&place, &arguments, signal, step_time * step as u32) {
                interrupted += 1;
                judge(&place, &arguments, output, &before, &done);
            } else {
                assert!(place.contents() == done);
            }
            place.write(output, "");
        }
        assert!(interrupted > 0, "`vdt {arguments}` was done before every interruption");
        std::fs::remove_file(place.path(output)).unwrap();
    }
}

#[test]
fn ctrl_c_and_termination_leave_everything_as_it_was() {
    interrupt_often(&["INT", "TERM"], |place, _, output, before, done| {
        let after = place.contents();
        // Or the file had its name already, and only the report of it was to be printed.
        assert!(after == *before || after == *done, "{output}: {:?}", place.names());
    });
}

/// Against this signal nothing can be done: a temporary file and a scratch folder may be left, but never half an output;
/// and the next run of the command removes them.
#[test]
fn killed_outright_no_output_is_left_half_written() {
    interrupt_often(&["KILL"], |place, arguments, output, before, done| {
        let mut after = place.contents();
        let temporary = |path: &Path| path.to_string_lossy().starts_with(&format!(".{output}."));
        let left: Vec<_> = after.keys().filter(|path| temporary(path)).cloned().collect();
        for path in &left {
            after.remove(path);
        }
        // The temporary file of the output, and the scratch folder of a build.
        let on_top = left.iter().filter(|path| path.components().count() == 1).count();
        assert!(on_top <= 2 && (after == *before || after == *done), "{output}: {:?}", place.names());
        if !left.is_empty() {
            place.run(arguments).success();
            assert!(place.contents() == *done, "{output}: {:?}", place.names());
        }
    });
}
