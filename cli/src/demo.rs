//! `vdt demo`: the whole way on a mesh that it makes. Each step is this program run again as a process of its own, so
//! that the peak RAM of the flight is the flight's, by the operating system's figure, and not that of the build.

use std::io::{self, Write};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use storage::{ByteSize, LocalDisk};

use crate::arguments::DemoOptions;
use crate::chart::flight_chart;
use crate::output::{Report, counted, grouped, write_text};
use crate::progress::Progress;

/// The size of the picture that it ends with.
const PICTURE_SIZE: &str = "1280x720";

pub fn run(options: DemoOptions, json: bool) -> Result<()> {
    let start = Instant::now();
    std::fs::create_dir_all(&options.output)
        .with_context(|| format!("cannot make the folder {}", options.output.display()))?;
    let [mesh, model, csv, chart, picture] =
        ["terrain.ply", "terrain.vdt", "flight.csv", "flight.svg", "flight.png"].map(|name| options.output.join(name));
    let say = |text: String| -> Result<()> {
        if !json {
            writeln!(io::stdout(), "{text}")?;
        }
        Ok(())
    };

    say(format!("1. A terrain of {} triangles", grouped(options.triangles)))?;
    let triangles = options.triangles.to_string();
    let generated = step(&["generate", "terrain", "--triangles", &triangles, "--force", "-o"], &mesh, &[])?;
    say(format!("   {}: {}, {:.1} s", mesh.display(), size(&generated, "bytes"), float(&generated, "seconds")))?;

    say("2. Its model: collapse edges, number, block into meta-nodes".into())?;
    let build_memory = options.build_memory.0.to_string();
    let built = step(&["build"], &mesh, &["--memory", &build_memory, "--force", "-o", &path(&model)?])?;
    say(format!(
        "   {}: {}, {:.1} bytes per vertex, {}, {:.1} s, peak RAM {}",
        model.display(),
        size(&built, "model_bytes"),
        float(&built, "model_bytes") / float(&built, "vertices").max(1.0),
        counted(whole(&built, "meta_nodes"), "meta-node", "meta-nodes"),
        float(&built, "seconds"),
        size(&built, "peak_rss_bytes"),
    ))?;

    say("3. Every byte, link and invariant of it checked; fully refined, it is the terrain".into())?;
    let verified = step(&["verify"], &model, &["--against", &path(&mesh)?])?;
    say(format!("   {}, {}", counted(whole(&verified, "splits"), "split", "splits"), size(&verified, "bytes")))?;

    say(format!("4. A flight over it in {} of RAM, {} frames at 60 a second", options.memory, options.frames))?;
    let (flight_path, memory) = (format!("flyby:{}", options.frames), options.memory.0.to_string());
    let flight_options = ["--path", &flight_path, "--memory", &memory, "--force", "--csv", &path(&csv)?];
    let flown = step(&["navigate"], &model, &flight_options)?;
    let figures = std::fs::read_to_string(&csv).with_context(|| format!("cannot read {}", csv.display()))?;
    let title = format!(
        "{} triangles in {} of RAM: {:.2} % misses",
        grouped(whole(&built, "triangles")),
        options.memory,
        float(&flown, "miss_percent")
    );
    write_text(Arc::new(LocalDisk), &chart, &flight_chart(&figures, &title)?)?;

    let limit = ByteSize(options.memory.0 + (8 << 20));
    let mut report = Report::default();
    report.line("   triangles", format!("{} in a frame on average", grouped(float(&flown, "triangles_mean") as u64)));
    report
        .line("   adapts", format!("{} splits and collapses in a frame", grouped(float(&flown, "adapts_mean") as u64)));
    report.line("   misses", format!("{:.2} % of the requests", float(&flown, "miss_percent")));
    report.line(
        "   frame time",
        format!(
            "{:.2} ms median, {:.2} ms at the 99th percentile",
            float(&flown, "frame_ms_p50"),
            float(&flown, "frame_ms_p99")
        ),
    );
    report.line(
        "   disk",
        format!("{} meta-nodes read, {}", grouped(whole(&flown, "reads")), size(&flown, "bytes_read")),
    );
    report.line(
        "   peak RAM",
        format!(
            "{}, by the operating system; allowed are {} and 8 MiB for the program, {limit}",
            size(&flown, "peak_rss_bytes"),
            options.memory,
        ),
    );
    report.line("   chart", chart.display());
    if !json {
        report.print_lines()?;
    }

    let frame = options.frames.saturating_sub(1) * 2 / 3;
    say(format!("5. Frame {frame} of it as a picture, drawn by the processor"))?;
    let seen_from = ["--path", &flight_path, "--frame", &frame.to_string(), "--settle", "--size", PICTURE_SIZE];
    let seen_from: Vec<&str> = seen_from.into_iter().chain(["--force", "-o"]).collect();
    let drawn = step(&["render"], &model, &[seen_from.as_slice(), &[&path(&picture)?]].concat())?;
    let triangles = counted(whole(&drawn, "triangles"), "triangle", "triangles");
    say(format!("   {}: {triangles}, {:.1} s", picture.display(), float(&drawn, "seconds")))?;

    let mut report = Report::default();
    report.line("", "");
    report.line(
        "done",
        format!("in {:.0} s; what was made is in {}", start.elapsed().as_secs_f64(), options.output.display()),
    );
    report.line("next", format!("vdt info {}", model.display()));
    report.line("", format!("vdt extract {} -o small.ply --triangles 20000", model.display()));
    report.print(
        json,
        &json!({
            "seconds": start.elapsed().as_secs_f64(),
            "mesh": mesh,
            "model": model,
            "csv": csv,
            "chart": chart,
            "generate": generated,
            "build": built,
            "verify": verified,
            "navigate": flown,
            "picture": picture,
            "render": drawn,
        }),
    )
}

/// Runs this program with `before`, `file`, `after` and `--json`. What a step that fails says is what the demo says.
fn step(before: &[&str], file: &Path, after: &[&str]) -> Result<Value> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let progress = Progress::waiting("working");
    let output = Command::new(program)
        .args(before)
        .arg(file)
        .args(after)
        .arg("--json")
        .output()
        .context("cannot start this program again")?;
    drop(progress);
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr);
        let message = message.trim().trim_start_matches("vdt: ");
        // The demo has two budgets, and its flight's is the one that is called as the step's is.
        let option = if before == ["build"] { "--build-memory" } else { "--memory" };
        bail!("{}", message.replace("--memory", option));
    }
    serde_json::from_slice(&output.stdout).context("a step of the demo printed no JSON")
}

fn path(path: &Path) -> Result<String> {
    let text =
        path.to_str().with_context(|| format!("{}: please use a folder whose name is Unicode", path.display()))?;
    Ok(text.to_owned())
}

fn whole(document: &Value, key: &str) -> u64 {
    document[key].as_u64().unwrap_or(0)
}

fn float(document: &Value, key: &str) -> f64 {
    document[key].as_f64().unwrap_or(0.0)
}

fn size(document: &Value, key: &str) -> String {
    document[key].as_u64().map_or_else(|| "unknown".into(), |bytes| ByteSize(bytes).to_string())
}
