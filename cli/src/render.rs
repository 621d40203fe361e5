//! `vdt render`: pictures of a model, as PNG files.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use metanode::model::Model;
use navigator::path::overview;
use navigator::{Camera, FrameStatistics, Io, Navigator, NavigatorError, NavigatorOptions, PathSpec};
use render::{Buffers, Picture, Projection, Style, draw};
use serde_json::json;
use storage::{AtomicFile, ByteSize, Disk, LocalDisk};

use crate::arguments::{PictureSize, RenderOptions};
use crate::extract::MOST_FRAMES;
use crate::output::{Report, counted, grouped, length, may_write};
use crate::progress::Progress;

/// Bytes for each point while a picture is encoded: its colours once more, and what becomes of them.
const ENCODING_BYTES: u64 = 7;

/// What was drawn.
struct Drawn {
    pictures: u64,
    /// Points of the last picture in which the model is seen.
    points: u64,
    settled: bool,
    last: FrameStatistics,
}

pub fn run(options: &RenderOptions, json: bool) -> Result<()> {
    let start = Instant::now();
    let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
    let model = Arc::new(Model::open(&LocalDisk, &options.model)?);
    let mut cameras = cameras(options, disk.as_ref(), &model)?;
    let is_film = options.frame.is_none() && cameras.len() > 1;
    if let Some(frame) = options.frame {
        if frame >= cameras.len() {
            bail!("the path has {}: there is no frame {frame}, the last is {}", frames(&cameras), cameras.len() - 1);
        }
        cameras.truncate(frame + 1);
    }
    if is_film {
        make_folder(&options.output, options.force)?;
    } else {
        let is_png = |extension: &std::ffi::OsStr| extension.eq_ignore_ascii_case("png");
        if !options.output.extension().is_some_and(is_png) {
            bail!("{}: pictures are PNG files: name one that ends in .png", options.output.display());
        }
        let mut inputs = vec![options.model.as_path()];
        if let Some(PathSpec::File(path)) = &options.path {
            inputs.push(path);
        }
        may_write(disk.as_ref(), &options.output, options.force, &inputs)?;
    }

    let PictureSize { width, height } = options.picture.size;
    let for_picture = u64::from(width) * u64::from(height) * (Picture::POINT_BYTES + ENCODING_BYTES);
    let Some(memory) = options.memory.0.checked_sub(for_picture) else {
        let (size, needed) = (format!("{width}x{height}"), ByteSize(for_picture));
        bail!("a picture of {size} points takes {needed} of RAM, more than {}: give more --memory", options.memory);
    };
    let navigator_options = NavigatorOptions {
        memory,
        pixels: options.picture.pixels,
        width,
        height,
        geomorph: options.geomorph,
        io: Io::Sync,
        ..NavigatorOptions::default()
    };
    let mut navigator = match Navigator::open(model.clone(), navigator_options) {
        Err(NavigatorError::Budget(error)) => {
            let (path, needed) = (options.model.display(), (error.smallest + for_picture).div_ceil(1024));
            bail!(
                "{path}: {} of RAM are too few for this model and the picture; give --memory {needed}K",
                options.memory
            )
        }
        opened => opened?,
    };
    let mut picture = Picture::new(width, height);
    let mut drawn = Drawn { pictures: 0, points: 0, settled: false, last: FrameStatistics::default() };
    let progress = Progress::new("drawing");
    for (number, camera) in cameras.iter().enumerate() {
        let is_last = number + 1 == cameras.len();
        let is_to_be_drawn = is_film || is_last;
        let is_to_settle = is_to_be_drawn && (options.settle || options.path.is_none());
        drawn.last =
            if is_to_settle { navigator.run_until_settled(camera, MOST_FRAMES)? } else { navigator.frame(camera)? };
        if is_to_be_drawn {
            paint(&mut picture, &navigator, camera, options.edges)?;
            let path = if is_film { frame_path(&options.output, number) } else { options.output.clone() };
            write(&disk, &path, &picture)?;
            drawn.pictures += 1;
        }
        progress.show((number + 1) as f64 / cameras.len() as f64);
    }
    drop(progress);
    drawn.points = picture.distances().filter(|distance| distance.is_finite()).count() as u64;
    drawn.settled = navigator.settled();
    drop(navigator);
    tell(options, &model, &drawn, start.elapsed().as_secs_f64(), json)
}

fn frames(cameras: &[Camera]) -> String {
    counted(cameras.len() as u64, "frame", "frames")
}

/// Where to look from, in the order of the pictures.
fn cameras(options: &RenderOptions, disk: &dyn Disk, model: &Model) -> Result<Vec<Camera>> {
    Ok(match (&options.path, options.camera) {
        (Some(path), _) => path.cameras(disk, model)?,
        (None, Some(camera)) => {
            let camera = camera.camera();
            camera.frame().context("--camera")?;
            vec![camera]
        }
        (None, None) => vec![overview(model, options.picture.size.width, options.picture.size.height)],
    })
}

/// The folder for the frames of a film: a new one, or an empty one, or any that may be written to.
fn make_folder(folder: &Path, force: bool) -> Result<()> {
    if folder.exists() && !folder.is_dir() {
        bail!(
            "{}: this is a file; all frames of a path go to a folder, one of them is chosen by --frame",
            folder.display()
        );
    }
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    let mut entries = folder.read_dir().with_context(|| format!("{}: cannot be read", folder.display()))?;
    if entries.next().is_some() && !force {
        bail!(
            "{}: there is something in the folder already; use --force to write there, or name another",
            folder.display()
        );
    }
    Ok(())
}

fn frame_path(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("{number:06}.png"))
}

/// Draws what the navigator has for this camera.
fn paint(picture: &mut Picture, navigator: &Navigator, camera: &Camera, edges: bool) -> Result<()> {
    let header = navigator.model().header();
    let projection = Projection::new(camera, header.origin, header.diagonal(), picture.width(), picture.height())?;
    let buffers = Buffers {
        vertices: navigator.vertex_stream(),
        morphs: navigator.morph_stream(),
        triangles: navigator.triangle_stream(),
    };
    picture.clear();
    draw(picture, &projection, buffers, Style { edges, ..Style::default() });
    Ok(())
}

fn write(disk: &Arc<dyn Disk>, path: &Path, picture: &Picture) -> Result<()> {
    let mut bytes = Vec::new();
    let colours = picture.colours().as_flattened();
    PngEncoder::new(&mut bytes)
        .write_image(colours, picture.width(), picture.height(), ExtendedColorType::Rgb8)
        .with_context(|| format!("{}: cannot be encoded", path.display()))?;
    let mut file = AtomicFile::create(disk.clone(), path)?;
    file.append(&bytes)?;
    file.commit()?;
    Ok(())
}

fn tell(options: &RenderOptions, model: &Model, drawn: &Drawn, seconds: f64, json: bool) -> Result<()> {
    let PictureSize { width, height } = options.picture.size;
    let (last, pixels) = (&drawn.last, options.picture.pixels);
    let mut report = Report::default();
    if drawn.pictures > 1 {
        let pictures = counted(drawn.pictures, "picture", "pictures");
        report.line("pictures", format!("{pictures} in {}", options.output.display()));
    } else {
        report.line("picture", options.output.display());
    }
    let share = 100.0 * drawn.points as f64 / (f64::from(width) * f64::from(height));
    report.line("size", format!("{width}x{height}; the model is seen in {share:.1} % of the last"));
    let all = grouped(model.header().triangle_count.into());
    report.line("triangles", format!("{} of {all} in the last", grouped(last.triangles)));
    report
        .line("error", format!("{:.2} pixels, {} in mesh units", last.pixels_drawn, length(last.error_stated.into())));
    report.line("drawn by", "the processor");
    let is_single = options.path.is_none() || options.settle;
    if last.threshold_factor > 1.0 {
        let allowed = pixels * last.threshold_factor;
        report.line("note", format!("the memory did not allow {pixels} pixels, but {allowed:.1}"));
    } else if is_single && !drawn.settled {
        report.line("note", "the picture is not finished: the memory is too little for what it needs at once");
    }
    let document = json!({
        "pictures": drawn.pictures,
        "width": width,
        "height": height,
        "points_drawn": drawn.points,
        "triangles": last.triangles,
        "pixels_drawn": last.pixels_drawn,
        "error_stated": last.error_stated,
        "guaranteed": last.guaranteed,
        "threshold_factor": last.threshold_factor,
        "settled": drawn.settled,
        "renderer": "software",
        "seconds": seconds,
        "peak_rss_bytes": storage::usage::peak_resident_bytes(),
    });
    report.print(json, &document)
}
