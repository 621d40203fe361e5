//! The program `vdt`: view-dependent models of triangle meshes of any size, in a RAM budget that the user sets.
//!
//! All of it is this library, so that the tests can build it under their own roof; `main.rs` only calls [`run`]. One file
//! per command. What a command prints for people goes to standard output; with `--json` it is one JSON
//! document and nothing else. Progress goes to standard error, on a terminal only. Exit codes: 0 done, 1 failed, 2 wrong
//! usage.

mod against;
mod arguments;
mod bench;
mod build;
mod chart;
mod compare;
mod convert;
mod demo;
mod extract;
mod generate;
mod info;
mod navigate;
mod output;
mod progress;
mod render;
mod statement;
mod table;
mod verify;
mod view;
mod warnings;

use std::process::ExitCode;

use clap::Parser;

use arguments::{Arguments, Command};

/// Exit code of a program that was interrupted, as shells have it.
const INTERRUPTED: i32 = 130;

/// Runs the program with the command line of this process.
pub fn run() -> ExitCode {
    storage::usage::return_freed_memory();
    let Arguments { command, json } = Arguments::parse();
    if let Err(error) = ctrlc::set_handler(stop) {
        eprintln!("vdt: Ctrl-C will leave temporary files behind: {error}");
    }
    let result = match command {
        Command::Demo(options) => demo::run(options, json),
        Command::Generate(options) => generate::run(options, json),
        Command::Build(options) => build::run(options, json),
        Command::Info(options) => info::run(options, json),
        Command::Verify(options) => verify::run(options, json),
        Command::Extract(options) => extract::run(options, json),
        Command::Convert(options) => convert::run(&options, json),
        Command::Navigate(options) => navigate::run(options, json),
        Command::Render(options) => render::run(&options, json),
        Command::View(options) => view::run(options, json),
        Command::Compare(options) => compare::run(&options, json),
        Command::Bench(options) => bench::run(options, json),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vdt: {}", message(&error));
            ExitCode::FAILURE
        }
    }
}

/// The error with its causes, without those that it has told itself.
fn message(error: &anyhow::Error) -> String {
    let mut message = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if message.is_empty() {
            message = cause;
        } else if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

/// On Ctrl-C or a request to terminate: an output that is not whole yet goes, its predecessor stays. A build that was
/// started to be measured ends, too. A soak prints what it came to, unless it is told twice.
fn stop() {
    if bench::end_early() {
        return;
    }
    end_at_once()
}

/// Ends the program although work is being done: what is not whole yet goes, but for what a build can go on from.
fn end_at_once() -> ! {
    // Nothing is written any more before the bench's folder is removed.
    let _standstill = storage::remove_unfinished();
    let _ended = bench::end();
    eprintln!("vdt: interrupted");
    std::process::exit(INTERRUPTED)
}

/// Whoever read our output had enough of it (`vdt info … | head`): that is not a failure.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<std::io::Error>())
        .any(|cause| cause.kind() == std::io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use anyhow::{Context, anyhow};

    use super::*;

    #[test]
    fn a_cause_is_told_once() {
        let error = anyhow!("no such file").context("cannot open x: no such file").context("the step failed");
        assert_eq!(message(&error), "the step failed: cannot open x: no such file");
        let failed: anyhow::Result<()> = Err(anyhow!("a")).context("b");
        assert_eq!(message(&failed.unwrap_err()), "b: a");
    }
}
