//! The command line, with its help.

use std::error::Error;
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use metanode::blocking::{ParseBlockingError, check_parameters};
use metanode::header::{Blocking, ErrorBound, Metric, Strategy};
use navigator::view_parameters::MOST_FINER;
use navigator::{Camera, Dependency, Light, PathSpec, ViewParameters};
use render::Renderer;
use storage::{ByteSize, EdgeTreeKind, MapAdvice};
use vdt::generate::{Shape, TRIANGLES};
use vdt::ingest::PositionsRule;

use crate::bench::{Blockings, MemoryShare, StrategyChoice};

/// View-dependent models of triangle meshes: build one, check it, take levels of detail out of it, and fly through it
/// in a RAM budget that you set.
#[derive(Debug, Parser)]
#[command(
    name = "vdt",
    version,
    max_term_width = 110,
    arg_required_else_help = true,
    after_help = "Sizes take K, M and G (binary). Exit codes: 0 done, 1 failed, 2 wrong usage. \
                  Begin with `vdt demo`."
)]
pub struct Arguments {
    /// Print one JSON document on standard output, and nothing else there.
    #[arg(long, global = true)]
    pub json: bool,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a terrain, build its model and fly through it in 16 MB: the whole way, in under a minute.
    Demo(DemoOptions),
    /// Make a test mesh of any size, as PLY, OBJ or binary glTF.
    Generate(GenerateOptions),
    /// Build a model from a mesh (PLY, OBJ, STL, OFF, glTF).
    Build(BuildOptions),
    /// Say what is in a model or mesh file.
    Info(InfoOptions),
    /// Check every byte, link and invariant of a model.
    Verify(VerifyOptions),
    /// Take a level of detail out of a model, as PLY, OBJ or binary glTF.
    Extract(ExtractOptions),
    /// Write a mesh in another format, with its attributes, or a level of detail of it.
    Convert(ConvertOptions),
    /// Fly along a camera path within a RAM budget, and report what every frame did.
    Navigate(NavigateOptions),
    /// Draw pictures of a model into PNG files
    Render(RenderOptions),
    /// Open a model or a mesh in a window, and fly.
    View(ViewOptions),
    /// Say how far two meshes are apart: mean, root mean square and largest distance, both ways.
    Compare(CompareOptions),
    /// Measure how meshes are built, what models state, and what flights read and take: the paper's Tables 1 and 2 and more.
    Bench(BenchOptions),
}

/// `vdt demo`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt demo\n  vdt demo --triangles 4000000 --build-memory 1G --memory 32M")]
pub struct DemoOptions {
    /// Folder for what the demo makes: terrain.ply, terrain.vdt, flight.csv, flight.svg. Files of these names in it are
    /// replaced.
    #[arg(short, long, default_value = "vdt-demo")]
    pub output: PathBuf,
    /// Triangles of the terrain.
    #[arg(long, default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(TRIANGLES))]
    pub triangles: u64,
    /// RAM for building the model.
    #[arg(long, default_value = "256M")]
    pub build_memory: ByteSize,
    /// RAM for flying through it.
    #[arg(long, default_value = "16M")]
    pub memory: ByteSize,
    /// Frames of the flight, at 60 a second.
    #[arg(long, default_value_t = 600, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: u32,
}

/// `vdt generate`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt generate terrain --triangles 1000000 -o terrain.ply\n  \
                             vdt generate gyroid --triangles 50000 --seed 7 -o gyroid.ply")]
pub struct GenerateOptions {
    /// terrain (a sheet, sampled unevenly), sphere (closed), gyroid (closed, of very many handles) or city (many parts,
    /// boundaries, non-manifold edges).
    pub shape: Shape,
    /// How many triangles, 10 to 1000000000. Sphere and gyroid come near it, terrain and city meet it.
    #[arg(long, value_parser = clap::value_parser!(u64).range(TRIANGLES))]
    pub triangles: u64,
    /// Another seed gives another mesh of the same kind; the same one, the same bytes.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Where to write it: as OBJ where the name ends in .obj, binary glTF where it ends in .glb, else as PLY.
    #[arg(short, long)]
    pub output: PathBuf,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
}

/// `vdt build`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt build bunny.ply -o bunny.vdt\n  \
                             vdt build scan.obj -o scan.vdt --memory 2G\n  \
                             vdt build part1.stl part2.stl -o both.vdt --metric length --strategy btree\n  \
                             vdt build scan.obj -o scan.vdt --error-bound tight\n  \
                             vdt build part.stl -o part.vdt --positions lossless\n  \
                             vdt build huge.ply --dry-run")]
pub struct BuildOptions {
    /// Mesh files; several are taken as one mesh.
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Where to write the model.
    #[arg(short, long, value_name = "MODEL.vdt", required_unless_present = "dry_run")]
    pub output: Option<PathBuf>,
    /// RAM for what grows with the mesh; what does not fit goes to the scratch. The model does not depend on it.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
    /// How many threads may work. The model does not depend on it. [default: as many as the machine runs at once]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// Folder for temporary files. [default: beside the model]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// What a collapse costs: quadric, the distance to the planes of the surface, or length, that of the edge.
    #[arg(long, default_value_t = Metric::Quadric, value_parser = one_of(&Metric::ALL))]
    pub metric: Metric,
    /// In which order edges are collapsed: passes, rounds of the cheapest fifth of the edges, fast and as good; or btree,
    /// the paper's, always the shortest edge.
    #[arg(long, default_value_t = Strategy::Passes, value_parser = one_of(&Strategy::ALL))]
    pub strategy: Strategy,
    /// What the errors of the model are: default, proven bounds on the distance from any point of the mesh to the surface
    /// drawn; fast, the same, looser and built faster; tight, tighter and slower; two-sided, as default, and from any point
    /// of the surface to the mesh; or none, the metric's estimates.
    #[arg(long, default_value_t, value_parser = one_of(&ErrorBound::ALL))]
    pub error_bound: ErrorBound,
    /// The B-tree of edges on disk for btree: redb, or sled where the memory is what sled was measured to need.
    #[arg(long, default_value_t, value_parser = one_of(&EdgeTreeKind::ALL))]
    pub edge_tree: EdgeTreeKind,
    /// How positions are kept: lossless; 10 to 24, rounded to a lattice of fewer than 2^BITS steps along the longest axis of
    /// the mesh; or auto, lossless where the mesh has a lattice of its own, as terrain in metres has, else 16 bits or as many
    /// more as fine edges need.
    #[arg(long, default_value_t, value_name = "auto|lossless|BITS")]
    pub positions: PositionsRule,
    /// Leave out the normals, colours, texture coordinates and materials of the mesh files; the model is as if they had none.
    #[arg(long)]
    pub no_attributes: bool,
    /// How the tree is cut into meta-nodes: forest:SLOT,CHILDREN fills slots of SLOT bytes, each with at most CHILDREN
    /// child meta-nodes; levels:L gives each meta-node L levels of one binary tree, as the paper does.
    #[arg(long, default_value_t, value_parser = blocking)]
    pub blocking: Blocking,
    /// Only say what the build would need.
    #[arg(long)]
    pub dry_run: bool,
    /// Replace an existing model.
    #[arg(long)]
    pub force: bool,
}

/// Takes one of several names, and lists them in the help.
fn one_of<T>(all: &[T]) -> impl TypedValueParser<Value = T> + use<T>
where
    T: Display + FromStr<Err: Error + Send + Sync + 'static> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(all.iter().map(|item| PossibleValue::new(item.to_string())))
        .try_map(|name| name.parse::<T>())
}

/// A blocking that can be.
fn blocking(text: &str) -> Result<Blocking, String> {
    let blocking: Blocking = text.parse().map_err(|error: ParseBlockingError| error.to_string())?;
    check_parameters(blocking).map_err(|error| error.to_string())?;
    Ok(blocking)
}

/// `vdt info`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt info bunny.vdt\n  vdt info bunny.vdt --pages\n  vdt info bunny.obj\n  \
                             vdt info --json bunny.vdt")]
pub struct InfoOptions {
    /// A model, or a mesh of any format that can be read.
    ///
    /// Of a model it tells counts, box, how positions are kept, errors, meta-nodes, bytes by section, and how it was built.
    /// Of a mesh it tells the numbers of elements, the box, and which attributes there are: normals, colours and texture
    /// coordinates of vertices, faces and corners, materials and their images. The file is read once, in little memory.
    pub file: PathBuf,
    /// Decode all pages of a model, too: for its smallest error, the triangles that are left at some errors, and the bytes
    /// of each kind of field. About a second for a million vertices.
    #[arg(long)]
    pub pages: bool,
}

/// `vdt verify`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt verify bunny.vdt\n  vdt verify bunny.vdt --against bunny.ply")]
pub struct VerifyOptions {
    /// The model.
    #[arg(value_name = "MODEL.vdt")]
    pub model: PathBuf,
    /// Check too that the model, fully refined, is exactly this mesh: the same triangles over the same positions.
    #[arg(long, value_name = "MESH")]
    pub against: Vec<PathBuf>,
    /// RAM for reading the mesh of --against.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
}

/// An error, in mesh units or as a share of the diagonal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ErrorArgument {
    /// In the units of the mesh.
    Units(f64),
    /// In percent of the diagonal of its bounding box.
    Percent(f64),
}

impl ErrorArgument {
    /// The error in mesh units.
    pub fn in_units(self, diagonal: f64) -> f64 {
        match self {
            ErrorArgument::Units(units) => units,
            ErrorArgument::Percent(percent) => percent / 100.0 * diagonal,
        }
    }
}

impl FromStr for ErrorArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, is_percent) = match text.strip_suffix('%') {
            Some(number) => (number, true),
            None => (text, false),
        };
        match number.trim().parse::<f64>() {
            Ok(value) if value >= 0.0 && value.is_finite() => {
                Ok(if is_percent { ErrorArgument::Percent(value) } else { ErrorArgument::Units(value) })
            }
            _ => Err(format!("`{text}` is not an error: write a length in mesh units, as in 0.01, or 0.1%")),
        }
    }
}

/// Where a camera stands and looks: six numbers with commas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraArgument {
    /// The eye.
    pub eye: [f64; 3],
    /// What is in the middle of the picture.
    pub target: [f64; 3],
}

impl CameraArgument {
    /// Vertical angle of view, in degrees.
    const FIELD_OF_VIEW: f64 = 60.0;

    /// The camera, with z upwards.
    pub fn camera(&self) -> Camera {
        Camera::looking_at(self.eye.into(), self.target.into(), Self::FIELD_OF_VIEW)
    }
}

impl FromStr for CameraArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a camera: write six numbers, as in 0,0,10,0,0,0 (eye, then target)");
        let numbers: Vec<f64> =
            text.split(',').map(|word| word.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
        match <[f64; 6]>::try_from(numbers) {
            Ok([a, b, c, d, e, f]) => Ok(CameraArgument { eye: [a, b, c], target: [d, e, f] }),
            Err(_) => Err(wrong()),
        }
    }
}

/// The size of a picture: 1920x1080.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureSize {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

impl PictureSize {
    /// 1920 by 1080 pixels.
    pub const FULL_HD: PictureSize = PictureSize { width: 1920, height: 1080 };
}

impl FromStr for PictureSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a picture size: write 1920x1080");
        let (width, height) = text.split_once('x').ok_or_else(wrong)?;
        let side = |text: &str| text.parse().ok().filter(|side| (1..=65_536).contains(side)).ok_or_else(wrong);
        Ok(PictureSize { width: side(width)?, height: side(height)? })
    }
}

/// `vdt extract`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt extract bunny.vdt -o same.ply --error 0\n  \
                             vdt extract bunny.vdt -o coarse.ply --error 0.1%\n  \
                             vdt extract bunny.vdt -o small.ply --triangles 5000\n  \
                             vdt extract bunny.vdt -o seen.ply --camera 0,0.1,0.4,0,0.1,0 --pixels 2")]
pub struct ExtractOptions {
    /// The model.
    #[arg(value_name = "MODEL.vdt")]
    pub model: PathBuf,
    /// Where to write the mesh; its extension says the format: .ply, .obj or .glb.
    #[arg(short, long, value_name = "MESH")]
    pub output: PathBuf,
    #[command(flatten)]
    pub cut: CutOptions,
    /// With --camera: error to be seen at most, in pixels [default: 1].
    #[arg(long, value_parser = positive)]
    pub pixels: Option<f32>,
    /// With --camera: size of the picture that the pixels are of [default: 1920x1080].
    #[arg(long)]
    pub size: Option<PictureSize>,
    /// With --camera: RAM for refining the view [default: 256M].
    #[arg(long)]
    pub memory: Option<ByteSize>,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
}

impl ExtractOptions {
    /// Ends the program with a message about usage where an option of a camera is given without one. (clap's `requires`
    /// does not see it, since --camera cannot be given beside --error or --triangles.)
    pub fn check(&self) {
        let given =
            [("--pixels", self.pixels.is_some()), ("--size", self.size.is_some()), ("--memory", self.memory.is_some())];
        if let Some((name, _)) = given.iter().find(|(_, given)| *given && self.cut.camera.is_none()) {
            let message = format!("{name} goes with --camera only: the same detail everywhere has no picture");
            Arguments::command().error(ErrorKind::MissingRequiredArgument, message).exit();
        }
    }
}

/// `vdt convert`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Without a level of detail all triangles with three different corners are written, each once, at \
                       their positions in single precision (relative to an origin of the mesh's own where that asks for \
                       it), with normals, colours, texture coordinates, materials and images. With one, a model is built \
                       first, as by `vdt build --positions lossless`, and removed afterwards; for several levels build it \
                       once and use `vdt extract`.\n\n\
                       Examples:\n  vdt convert scan.obj scan.glb\n  \
                       vdt convert part1.stl part2.stl both.ply\n  \
                       vdt convert scan.glb small.glb --triangles 20000\n  \
                       vdt convert scan.ply coarse.obj --error 0.1% --memory 1G"
)]
pub struct ConvertOptions {
    /// Mesh files, of any format that can be read; several are taken as one mesh.
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// Where to write the mesh; its extension says the format: .ply, .obj or .glb.
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Write the same detail everywhere, with at most this error. In mesh units, or with % of the diagonal.
    #[arg(long)]
    pub error: Option<ErrorArgument>,
    /// Write the same detail everywhere: the finest with at most so many triangles.
    #[arg(long, conflicts_with = "error")]
    pub triangles: Option<u64>,
    /// RAM for what grows with the mesh; what does not fit goes to the scratch. The result does not depend on it.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
    /// How many threads may work. The result does not depend on it. [default: as many as the machine runs at once]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// Folder for temporary files. [default: beside the output]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// Leave out normals, colours, texture coordinates and materials.
    #[arg(long)]
    pub no_attributes: bool,
    /// Replace an existing file, and what lies beside it: images, a library of materials.
    #[arg(long)]
    pub force: bool,
}

/// Which level of detail.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct CutOptions {
    /// The same detail everywhere: split every node whose error is larger than this. In mesh units, or with % of the
    /// diagonal; 0 is the whole mesh.
    #[arg(long)]
    pub error: Option<ErrorArgument>,
    /// The same detail everywhere: the finest with at most so many triangles.
    #[arg(long)]
    pub triangles: Option<u64>,
    /// The detail that a camera needs: eye and target, six numbers with commas.
    #[arg(long, value_name = "EYE,TARGET", allow_hyphen_values = true)]
    pub camera: Option<CameraArgument>,
}

fn positive(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("`{text}` is not a number above 0")),
    }
}

/// How many times an error counts.
fn finer(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if (1.0..=MOST_FINER).contains(&value) => Ok(value),
        _ => Err(format!("`{text}` is not a number from 1 to {MOST_FINER}")),
    }
}

/// A direction that is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction(pub [f64; 3]);

impl FromStr for Direction {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a direction: write three numbers, not all zero, as in 1,1,3");
        let numbers: Vec<f64> =
            text.split(',').map(|word| word.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
        let direction = <[f64; 3]>::try_from(numbers).map_err(|_| wrong())?;
        let light = Light { direction: direction.into(), highlights: 1.0 };
        let parameters = ViewParameters { light: Some(light), ..ViewParameters::default() };
        parameters.check().map(|()| Direction(direction)).map_err(|_| wrong())
    }
}

fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("`{text}` is not a number of 0 or more")),
    }
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    not_negative(text)
        .ok()
        .filter(|value| (f64::MIN_POSITIVE..=1e9).contains(value))
        .ok_or_else(|| format!("`{text}` is not a number of seconds above 0"))
}

fn percent(text: &str) -> Result<f64, String> {
    not_negative(text)
        .ok()
        .filter(|value| *value <= 100.0)
        .ok_or_else(|| format!("`{text}` is not a number from 0 to 100"))
}

/// How changes of neighbours depend on each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DependencyName {
    /// The paper's: by vertex ids, with forced splits. Every triangle is one that the construction went through.
    Implicit,
    /// Every node for itself, but where a triangle would be turned round, nodes around it are split until it is not.
    Flip,
    /// Every node for itself: fewer triangles, but the surface may fold over.
    None,
}

impl From<DependencyName> for Dependency {
    fn from(name: DependencyName) -> Self {
        match name {
            DependencyName::Implicit => Dependency::Implicit,
            DependencyName::Flip => Dependency::Flip,
            DependencyName::None => Dependency::None,
        }
    }
}

impl Display for DependencyName {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            DependencyName::Implicit => "implicit",
            DependencyName::Flip => "flip",
            DependencyName::None => "none",
        })
    }
}

/// How pages are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum IoName {
    /// By threads beside the navigation, which never waits for the disk.
    Thread,
    /// At once, within the frame, which waits.
    Sync,
    /// Not at all: they all lie decoded in a file that is mapped into memory, and the operating system sees to what is in
    /// RAM. For comparison; frames wait for the disk, and --memory bounds the front only.
    Mmap,
}

/// What becomes of pages that nobody needs at the moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PolicyName {
    /// The paper's: as long as its place holder is not needed, such a page is found again without a disk read.
    SecondChance,
    /// The one that was not used for the longest time makes room for others, whether it will be needed soon or not.
    Lru,
    /// It is forgotten.
    None,
}

/// What is asked of the pictures of a flight.
#[derive(Debug, Clone, Copy, Args)]
pub struct PictureOptions {
    /// Error to be seen at most, in pixels.
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    pub pixels: f32,
    /// Size of the picture that the pixels are of.
    #[arg(long, default_value = "1920x1080")]
    pub size: PictureSize,
}

/// What pictures are drawn by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RendererChoice {
    /// Graphics hardware where there is any, else the processor.
    Auto,
    /// Any graphics driver.
    Gpu,
    /// The processor, without a driver.
    Software,
}

impl From<RendererChoice> for Renderer {
    fn from(choice: RendererChoice) -> Self {
        match choice {
            RendererChoice::Auto => Renderer::Auto,
            RendererChoice::Gpu => Renderer::Gpu,
            RendererChoice::Software => Renderer::Software,
        }
    }
}

/// `vdt render`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Pictures are drawn without a window: by graphics hardware where there is any, else by the processor. \
                             A graphics driver takes RAM of its own beside --memory; --renderer software takes none.\n\n\
                             Examples:\n  vdt render bunny.vdt -o bunny.png\n  \
                             vdt render bunny.vdt -o near.png --camera 0,0.1,0.4,0,0.1,0 --size 800x600 --edges\n  \
                             vdt render bunny.vdt -o frame.png --path flyby:400 --frame 120 --memory 16M\n  \
                             vdt render bunny.vdt -o film --path orbit:250 --size 1280x720"
)]
pub struct RenderOptions {
    /// The model.
    #[arg(value_name = "MODEL.vdt")]
    pub model: PathBuf,
    /// The PNG file; with --path and no --frame a folder, for a file of each frame.
    #[arg(short, long, value_name = "IMAGE.png")]
    pub output: PathBuf,
    /// Where to look from, and at what: eye and target, six numbers with commas. [default: at all of the model]
    #[arg(long, value_name = "EYE,TARGET", allow_hyphen_values = true, conflicts_with = "path")]
    pub camera: Option<CameraArgument>,
    /// A camera path, as for navigate: orbit:FRAMES, flyby:FRAMES, or a file of cameras. It is flown from its beginning.
    #[arg(long)]
    pub path: Option<PathSpec>,
    /// Draw this frame of the path only; 0 is the first.
    #[arg(long, requires = "path")]
    pub frame: Option<usize>,
    /// With --path: finish each picture, whatever the flight before had time for. (A picture of a single camera always is.)
    #[arg(long, requires = "path")]
    pub settle: bool,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// Draw the sides of the triangles.
    #[arg(long)]
    pub edges: bool,
    /// Draw levels of detail in colours: each next one has half the error.
    #[arg(long)]
    pub levels: bool,
    /// Draw the meta-nodes in use as boxes.
    #[arg(long)]
    pub boxes: bool,
    /// What to draw by: auto, graphics hardware where there is any, else the processor; gpu, any graphics driver; software,
    /// the processor without one.
    #[arg(long, value_enum, default_value_t = RendererChoice::Auto)]
    pub renderer: RendererChoice,
    /// Memory on the graphics device.
    #[arg(long, default_value = "512M")]
    pub gpu_memory: ByteSize,
    /// With --path: let what a split adds go to its place in so many frames, so that nothing is seen to jump. 0: at once.
    #[arg(long, value_name = "FRAMES", default_value_t = 0, requires = "path", conflicts_with = "settle")]
    pub geomorph: u32,
    /// RAM for the navigation and the picture.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

/// `vdt view`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Of a mesh the model is built first, once, and kept beside it: scan.vdt beside scan.ply. The window \
                             opens where the model was left; H shows what mouse and keys do. It needs a display, and a \
                             driver for Vulkan or OpenGL; `vdt render` needs neither.\n\n\
                             Examples:\n  vdt view scan.ply\n  \
                             vdt view bunny.vdt --memory 64M --pixels 2\n  \
                             vdt view bunny.vdt --camera 0,0.1,0.4,0,0.1,0 --size 1920x1080"
)]
pub struct ViewOptions {
    /// A model, or a mesh of any format that can be read. [default: what is dropped onto the window]
    #[arg(value_name = "MODEL.vdt|MESH")]
    pub file: Option<PathBuf>,
    /// RAM for the navigation; a mesh is built within as much.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
    /// Memory of the graphics card for the model.
    #[arg(long, default_value = "512M")]
    pub gpu_memory: ByteSize,
    /// Error to be seen at most, in pixels.
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    pub pixels: f32,
    /// Draw at most so many triangles.
    #[arg(long, value_name = "N")]
    pub max_triangles: Option<u64>,
    /// Size of the window.
    #[arg(long, default_value = "1280x800")]
    pub size: PictureSize,
    /// Where to look from at first, and at what: eye and target, six numbers with commas. [default: where the model was left,
    /// else at all of it]
    #[arg(long, value_name = "EYE,TARGET", allow_hyphen_values = true)]
    pub camera: Option<CameraArgument>,
    /// Build the model of a mesh again where the one beside it is older, or is no model.
    #[arg(long)]
    pub force: bool,
}

/// `vdt navigate`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt navigate bunny.vdt --path flyby:200\n  \
                             vdt navigate bunny.vdt --path orbit:600 --memory 8M --pixels 2 --csv flight.csv\n  \
                             vdt navigate bunny.vdt --path cameras.txt --io sync --dependency none\n  \
                             vdt navigate bunny.vdt --path orbit:600 --silhouettes 3 --light 1,1,3 --highlights 4\n  \
                             vdt navigate bunny.vdt --path flyby:200 --io mmap --advice random --settle\n\n\
                             A path file has one camera a line, ten numbers: eye x y z, target x y z, up x y z, \
                             vertical field of view in degrees; # begins a comment.")]
pub struct NavigateOptions {
    /// The model.
    #[arg(value_name = "MODEL.vdt")]
    pub model: PathBuf,
    /// The camera path: orbit:FRAMES, flyby:FRAMES, or a file of cameras.
    #[arg(long)]
    pub path: PathSpec,
    /// RAM for everything that grows with the model: place holders, front, triangles.
    #[arg(long, default_value = "16M")]
    pub memory: ByteSize,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// Draw what is outside the picture as finely as what is in it. Without this, a sixteenth of its error counts from about
    /// 3 degrees outside on, more at the border.
    #[arg(long)]
    pub no_frustum: bool,
    /// Draw what faces away from the eye as finely as the rest. Without this, a sixteenth of its error counts.
    #[arg(long)]
    pub no_cones: bool,
    /// Draw silhouettes finer: their error counts FACTOR times, 1 (off) to 1000000. Where parts of the mesh have no inside, all
    /// of them.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = finer)]
    pub silhouettes: f32,
    /// The direction to a light, in the coordinates of the mesh; what shines in it is drawn finer, by --highlights.
    /// [default: no light]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub light: Option<Direction>,
    /// How many times the error counts within 15 degrees of a highlight of the --light, 1 (off) to 1000000.
    #[arg(long, value_name = "FACTOR", default_value_t = 2.0, value_parser = finer, requires = "light")]
    pub highlights: f32,
    /// How changes of neighbours depend on each other.
    #[arg(long, value_enum, default_value_t = DependencyName::Implicit)]
    pub dependency: DependencyName,
    /// Draw at most so many triangles.
    #[arg(long)]
    pub max_triangles: Option<u64>,
    /// Make at most so many splits and collapses in a frame, the most visible first; the rest waits for the next. 0: no limit.
    #[arg(long, default_value_t = navigator::MAX_ADAPTS)]
    pub max_adapts: u64,
    /// Let what a split adds go to its place in so many frames, so that nothing is seen to jump. 0: at once.
    #[arg(long, value_name = "FRAMES", default_value_t = 0)]
    pub geomorph: u32,
    /// How pages are read.
    #[arg(long, value_enum, default_value_t = IoName::Thread)]
    pub io: IoName,
    /// Threads that read and decode meta-nodes; unless given, as many as there are cores, two to four. Fewer where they would
    /// take too much of the memory.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub io_threads: Option<u16>,
    /// Read past the page cache of the operating system, where the file system can do that: the model is in RAM once then, but
    /// nothing is read ahead of what is asked for.
    #[arg(long)]
    pub direct: bool,
    /// With --io mmap: what the system is told of how the file will be read: normal, nothing; random, page by page;
    /// will-need, ahead as far as it likes; or populate, all of it before the flight, which shows how fast all would be in
    /// RAM [default: normal].
    #[arg(long, value_parser = one_of(&MapAdvice::ALL))]
    pub advice: Option<MapAdvice>,
    /// With --io mmap: the file of decoded meta-nodes, which is made where it is missing, and kept. [default: one in the
    /// system's folder for temporary files, removed afterwards]
    #[arg(long, value_name = "FILE")]
    pub decoded: Option<PathBuf>,
    /// Frames a second that are begun, at most; 0: each as soon as the last one is done. The I/O threads have the time in
    /// between, or with --io mmap the system.
    #[arg(long, default_value_t = 60.0, value_parser = not_negative)]
    pub frame_rate: f64,
    /// Begin with the picture of the first camera finished, as if the flight had gone on before: frames until then do not
    /// count.
    #[arg(long)]
    pub settle: bool,
    /// Fly the path once before, without counting: then RAM holds what it can of what the flight needs.
    #[arg(long)]
    pub warm: bool,
    /// Do not load meta-nodes ahead of time, by where the camera will probably be.
    #[arg(long)]
    pub no_prefetch: bool,
    /// What becomes of meta-nodes in RAM that nobody needs at the moment.
    #[arg(long, value_enum, default_value_t = PolicyName::SecondChance)]
    pub policy: PolicyName,
    /// Write the figures of every frame to this file.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Replace an existing CSV file.
    #[arg(long)]
    pub force: bool,
}

impl NavigateOptions {
    /// Ends the program with a message about usage where an option of mapped files is given without one.
    pub fn check(&self) {
        let given = [("--advice", self.advice.is_some()), ("--decoded", self.decoded.is_some())];
        if let Some((name, _)) = given.iter().find(|(_, given)| *given && self.io != IoName::Mmap) {
            let message = format!("{name} goes with --io mmap only");
            Arguments::command().error(ErrorKind::MissingRequiredArgument, message).exit();
        }
    }
}

/// `vdt compare`
#[derive(Debug, Args)]
#[command(
    after_long_help = "A distance is that of a point of one surface from the nearest point of the other; colours and \
                             other attributes are no part of it. Mean and rms are over the area, by samples. The \
                             largest distance is one that was found, at a point that is told; the true maximum lies \
                             between it and the bound beside it.\n\n\
                             Examples:\n  vdt compare bunny.ply small.ply\n  \
                             vdt compare scan.obj print.stl --samples 10000000 --memory 2G\n  \
                             vdt compare --json --one-sided bunny.ply small.ply"
)]
pub struct CompareOptions {
    /// The first mesh, of any format that can be read.
    pub mesh_a: PathBuf,
    /// The second mesh.
    pub mesh_b: PathBuf,
    /// Samples on each surface, spread evenly over its area. The vertices are looked at besides; of more vertices than
    /// samples, only so many.
    #[arg(long, default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000_000))]
    pub samples: u64,
    /// RAM for what grows with the meshes; what does not fit goes to the scratch. The result does not depend on it.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
    /// How many threads may work. The result does not depend on it. [default: as many as the machine runs at once]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// Measure only from the first mesh to the second.
    #[arg(long)]
    pub one_sided: bool,
    /// Do not compare colours. Else that is done where both meshes have any: of vertices, faces, textures (PNG, JPEG) or
    /// materials.
    #[arg(long)]
    pub no_colours: bool,
    /// Folder for temporary files. [default: the system's for temporary files]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
}

/// `vdt bench`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Each build is a process of its own, one after the other, so that RAM, CPU time and I/O are \
                             its own; models and temporary files are removed.\n\n\
                             Examples:\n  vdt bench table1 bunny.ply dragon.ply\n  \
                             vdt bench table2 dragon.vdt --plot table2.svg\n  \
                             vdt bench io dragon.ply --plot io.svg"
)]
pub struct BenchOptions {
    /// What to measure.
    #[command(subcommand)]
    pub command: BenchCommand,
}

/// What can be measured.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// The paper's Table 1: construction times, and sizes of tree, page data and directory.
    Table1(Table1Options),
    /// The paper's Table 2: frame times and misses of flights, by virtual memory and by our own I/O.
    Table2(Table2Options),
    /// Bytes read and written for each triangle, against the memory limit.
    Io(IoBenchOptions),
    /// The errors that a model states of its levels of detail, against measured ones.
    Error(ErrorBenchOptions),
    /// Sizes and shapes of meta-nodes: how full they are, and what a flight reads.
    Blocking(BlockingBenchOptions),
    /// How fast the meta-nodes of a model are decoded.
    Decode(DecodeBenchOptions),
    /// A long random walk with a disk that fails now and then: whether everything holds that must.
    Soak(SoakOptions),
    /// Implicit dependency, flip and none: triangles, how many are flipped, and frame times.
    Dependency(DependencyBenchOptions),
    /// Pictures of what is drawn against those of the full mesh: surface, outline, holes and cracks.
    Pictures(PicturesBenchOptions),
    /// What a renderer has to upload with each frame of a walk, against the triangles that are new or gone.
    Uploads(UploadsBenchOptions),
}

/// `vdt bench soak`
#[derive(Debug, Args)]
#[command(
    after_long_help = "The camera walks over the surface at random, jumps and stops. The invariants of front and place holders are \
                       checked, the memory in use is measured, and at every stop the picture must come to rest, with nothing \
                       left to be done, and be no coarser than that of a fresh start. Frames that cannot read a meta-node \
                       return an error, are counted, and the flight goes on. Ends as failed where an invariant was broken. Ctrl-C \
                       ends the walk and prints what it came to.\n\n\
                       Examples:\n  vdt bench soak dragon.vdt --seconds 3600 --json\n  \
                       vdt bench soak terrain.vdt --memory 128M --faults 5 --delay 50 --dependency none --frame-rate 0"
)]
pub struct SoakOptions {
    /// A model.
    #[arg(value_name = "MODEL.vdt")]
    pub model: PathBuf,
    /// For how long to walk, in seconds.
    #[arg(long, default_value_t = 60.0, value_parser = positive_seconds)]
    pub seconds: f64,
    /// RAM for the walk, as for navigate; a fresh start takes as much again, for a moment at every stop.
    #[arg(long, default_value = "16M")]
    pub memory: ByteSize,
    /// How many of all reads fail, in percent; as many are delayed, and as many bring a wrong bit.
    #[arg(long, value_name = "PERCENT", default_value_t = 1.0, value_parser = percent)]
    pub faults: f64,
    /// By how much reads are delayed, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 20, value_parser = clap::value_parser!(u64).range(0..=60_000))]
    pub delay: u64,
    /// For how long all reads fail, with the first jump after each stop, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(0..=60_000))]
    pub outage: u64,
    /// Which walk, and which faults.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How changes of neighbours depend on each other.
    #[arg(long, value_enum, default_value_t = DependencyName::Implicit)]
    pub dependency: DependencyName,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// Frames a second that are begun, at most; 0: each as soon as the last one is done. (At stops always 60.)
    #[arg(long, default_value_t = 60.0, value_parser = not_negative)]
    pub frame_rate: f64,
    /// With every so many frames the invariants are checked.
    #[arg(long, value_name = "FRAMES", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    pub check_every: u64,
}

/// `vdt bench dependency`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Each model is flown over with each dependency, with the same error. A triangle is flipped where its normal \
                       is more than 90 degrees from that of the triangle of the mesh that it stands for.\n\n\
                       Examples:\n  vdt bench dependency dragon.vdt\n  \
                       vdt bench dependency dragon.vdt terrain.vdt --path orbit:300 --pixels 2 --json"
)]
pub struct DependencyBenchOptions {
    /// Models.
    #[arg(required = true, value_name = "MODEL.vdt")]
    pub models: Vec<PathBuf>,
    /// The camera path: orbit:FRAMES, flyby:FRAMES, or a file of cameras, as for navigate. It is flown twice; the second time
    /// counts.
    #[arg(long, default_value = "flyby:300")]
    pub path: PathSpec,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// RAM for a flight, as for navigate.
    #[arg(long, default_value = "2G")]
    pub memory: ByteSize,
    /// Flipped triangles are counted in every so many-th frame.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub every: u32,
}

/// `vdt bench pictures`
#[derive(Debug, Args)]
#[command(
    after_long_help = "The cameras are: one that sees the whole model; half of the others on an orbit around it; the rest on a \
                       flight low over it. For each, the front is drawn when it has settled, and so is the full mesh, by the \
                       same software. Compared are: the places that the points show, with the nearest triangle of the other \
                       mesh, in footprints (heights of a point at that depth); the outlines; the points in which the full mesh \
                       is seen and the front is seen through; and, exactly, the sides that are open in one mesh and not in the \
                       other.\n\n\
                       Examples:\n  vdt bench pictures dragon.vdt terrain.vdt\n  \
                       vdt bench pictures dragon.vdt --cameras 9 --pixels 0.5 --size 1280x720 --json\n  \
                       vdt bench pictures dragon.vdt --cold --delay 100 --memory 16M"
)]
pub struct PicturesBenchOptions {
    /// Models.
    #[arg(required = true, value_name = "MODEL.vdt")]
    pub models: Vec<PathBuf>,
    /// Cameras for each model.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub cameras: u32,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// RAM for the front, as for navigate. The full mesh takes about 100 bytes a triangle beside it.
    #[arg(long, default_value = "1G")]
    pub memory: ByteSize,
    /// Look at the first, the 10th and the 100th frame after each start instead, 60 to the second, from a disk that is slow.
    #[arg(long)]
    pub cold: bool,
    /// By how much each read is delayed then, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 50, requires = "cold",
          value_parser = clap::value_parser!(u64).range(0..=60_000))]
    pub delay: u64,
}

/// `vdt bench uploads`
#[derive(Debug, Args)]
#[command(
    after_long_help = "A renderer keeps copies of two streams: 16 bytes for each vertex and 12 for each triangle. After each frame it \
                       uploads the ranges that have changed; two with at most GAP unchanged elements between them as one. A \
                       triangle is the same in two frames where its corners stand on the same leaves.\n\n\
                       Examples:\n  vdt bench uploads dragon.vdt terrain.vdt\n  \
                       vdt bench uploads dragon.vdt --path flyby:600 --gap 0,16 --json"
)]
pub struct UploadsBenchOptions {
    /// Models.
    #[arg(required = true, value_name = "MODEL.vdt")]
    pub models: Vec<PathBuf>,
    /// Frames of a random walk over the surface, 60 to the second. Where it jumps, the picture settles first, which is not counted.
    #[arg(long, value_name = "FRAMES", default_value_t = 600, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub walk: u32,
    /// Which walk.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// A camera path in place of the walk: orbit:FRAMES, flyby:FRAMES, or a file of cameras, as for navigate. The picture of its
    /// first camera settles first.
    #[arg(long, conflicts_with_all = ["walk", "seed"])]
    pub path: Option<PathSpec>,
    /// Most unchanged elements between two ranges that are uploaded as one.
    #[arg(long, value_delimiter = ',', default_value = "0,4,16,64,256")]
    pub gap: Vec<u32>,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// RAM for the flight, as for navigate.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
}

/// `vdt bench decode`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Examples:\n  vdt bench decode dragon.vdt\n  vdt bench decode dragon.vdt --threads 4 --json"
)]
pub struct DecodeBenchOptions {
    /// A model.
    pub model: PathBuf,
    /// Up to how many threads. [default: as many as the machine runs at once]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// How often the model is decoded by each number of threads; the run with the least CPU time counts.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
}

/// What all measurements have that build or fly.
#[derive(Debug, Args)]
pub struct SharedBenchOptions {
    /// How many threads may work. [default: as many as the machine runs at once]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// Folder for models and temporary files. [default: the system's for temporary files]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// Replace an existing picture.
    #[arg(long)]
    pub force: bool,
}

/// `vdt bench table1`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt bench table1 bunny.ply dragon.ply\n  \
                             vdt bench table1 *.ply --memory 64M --threads 1 --runs 3 --plot table1.svg")]
pub struct Table1Options {
    /// Mesh files, each a mesh of its own.
    #[arg(required = true, value_name = "MESH")]
    pub meshes: Vec<PathBuf>,
    /// RAM for what grows with a mesh.
    #[arg(long, default_value = "256M")]
    pub memory: ByteSize,
    /// In which order edges are collapsed, as for build, with the B-tree of edges: passes, btree:redb or btree:sled.
    #[arg(long, default_value = "passes")]
    pub strategy: StrategyChoice,
    /// What a collapse costs, as for build.
    #[arg(long, default_value_t = Metric::Quadric, value_parser = one_of(&Metric::ALL))]
    pub metric: Metric,
    /// What the errors of the models are, as for build.
    #[arg(long, default_value_t, value_parser = one_of(&ErrorBound::ALL))]
    pub error_bound: ErrorBound,
    /// How often each mesh is built; the run with the least CPU time counts.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Draw the CPU time for each triangle into this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// What all of these measurements have.
    #[command(flatten)]
    pub shared: SharedBenchOptions,
}

/// `vdt bench table2`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Each flight is a process of its own in a memory cgroup of the budget and 8 MiB (which mostly takes root; \
                       where there is none, the output says why), begins with nothing of its files in the system's cache, \
                       and with the picture of the first camera finished. Flown are, with the same front: by our I/O \
                       thread; by virtual memory, from one mapped file with all meta-nodes decoded, with each advice to \
                       the system (normal, random, will-need); and with all in RAM. Where the budget does not allow the \
                       error asked for, all of them fly with the first of its doubles that it allows.\n\n\
                       Examples:\n  vdt bench table2 dragon.vdt terrain.ply --plot table2.svg\n  \
                       vdt bench table2 dragon.vdt --path flyby:600 --path orbit:300 --memory 1/16,1/4,32M --runs 3"
)]
pub struct Table2Options {
    /// Meshes to be built, and models to be taken as they are.
    #[arg(required = true, value_name = "MESH|MODEL.vdt")]
    pub files: Vec<PathBuf>,
    /// The camera path: orbit:FRAMES, flyby:FRAMES, or a file of cameras, as for navigate. May be given several times.
    #[arg(long, default_value = "flyby:400")]
    pub path: Vec<PathSpec>,
    /// RAM for a flight, as for navigate: shares of what all meta-nodes take decoded and the front at most, or sizes. Never
    /// less than the smallest that works.
    #[arg(long, value_delimiter = ',', default_value = "1/8,1/4,1/2,1")]
    pub memory: Vec<MemoryShare>,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// Frames a second that are begun, at most; 0: each as soon as the last one is done.
    #[arg(long, default_value_t = 60.0, value_parser = not_negative)]
    pub frame_rate: f64,
    /// How often each flight is flown; the run with the least time for a frame counts.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// RAM for building.
    #[arg(long, default_value = "256M")]
    pub build_memory: ByteSize,
    /// Draw the times of frames against the memory into this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// What all of these measurements have.
    #[command(flatten)]
    pub shared: SharedBenchOptions,
}

/// `vdt bench io`
#[derive(Debug, Args)]
#[command(after_long_help = "Examples:\n  vdt bench io dragon.ply --plot io.svg\n  \
                             vdt bench io terrain.ply --memory 64M,256M --strategy passes --threads 1")]
pub struct IoBenchOptions {
    /// Mesh file.
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// RAM for what grows with the mesh: one or more limits, each of which is a point of the curve.
    #[arg(long, value_delimiter = ',', default_value = "16M,32M,64M,128M,256M")]
    pub memory: Vec<ByteSize>,
    /// In which order edges are collapsed, as for build, with the B-tree of edges: one or more of passes, btree:redb and
    /// btree:sled, each a curve.
    #[arg(long, value_delimiter = ',', default_value = "passes,btree:redb,btree:sled")]
    pub strategy: Vec<StrategyChoice>,
    /// What the errors of the models are, as for build.
    #[arg(long, default_value_t, value_parser = one_of(&ErrorBound::ALL))]
    pub error_bound: ErrorBound,
    /// Draw the bytes against the memory into this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// What all of these measurements have.
    #[command(flatten)]
    pub shared: SharedBenchOptions,
}

/// `vdt bench error`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Cuts are from 50 % to 0.5 % of the triangles. For each, the largest distance from the mesh to the \
                       cut is measured as by `vdt compare`. It counts as a violation where it is larger than what the \
                       model states.\n\n\
                       Examples:\n  vdt bench error bunny.vdt bunny.ply --plot error.svg\n  \
                       vdt bench error dragon.vdt dragon.ply --cuts 5 --samples 100000"
)]
pub struct ErrorBenchOptions {
    /// The model.
    #[arg(value_name = "MODEL.vdt")]
    pub model: PathBuf,
    /// The mesh that it was built from.
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// Cuts with the same detail everywhere, and as many of cameras.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub cuts: u32,
    /// Samples on each surface, as for compare.
    #[arg(long, default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000_000))]
    pub samples: u64,
    /// RAM for what grows with the mesh and the model.
    #[arg(long, default_value = "1G")]
    pub memory: ByteSize,
    /// Draw the ratios of stated and measured errors into this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// What all of these measurements have.
    #[command(flatten)]
    pub shared: SharedBenchOptions,
}

/// `vdt bench blocking`
#[derive(Debug, Args)]
#[command(
    after_long_help = "Each mesh is built once, and its tree then blocked in all ways asked for. Three flights follow: with \
                       RAM for the whole model, so that nothing is read twice; within --memory, each page read when it \
                       is missing; and the same with an I/O thread, in time, which may miss pages. A model is flown over \
                       as it is blocked.\n\n\
                       Examples:\n  vdt bench blocking bunny.ply --plot blocking.svg\n  \
                       vdt bench blocking scan.ply --blocking levels:5 --blocking forest:8K..64K,16 --positions 16\n  \
                       vdt bench blocking bunny.vdt dragon.vdt --path orbit:600 --memory 8M"
)]
pub struct BlockingBenchOptions {
    /// Meshes to be built and blocked, and models to be taken as they are.
    #[arg(required = true, value_name = "MESH|MODEL.vdt")]
    pub files: Vec<PathBuf>,
    /// How meshes are blocked: one as for build, or a range as in levels:3..8 or forest:8K..128K,16. May be given several
    /// times.
    #[arg(long, value_name = "BLOCKING", default_values = ALL_BLOCKINGS)]
    pub blocking: Vec<Blockings>,
    /// The camera path: orbit:FRAMES, flyby:FRAMES, or a file of cameras, as for navigate.
    #[arg(long, default_value = "flyby:300")]
    pub path: PathSpec,
    /// RAM for a flight, as for navigate.
    #[arg(long, default_value = "16M")]
    pub memory: ByteSize,
    /// What is asked of the pictures.
    #[command(flatten)]
    pub picture: PictureOptions,
    /// Frames a second of the flight in time; 0: each as soon as the last one is done.
    #[arg(long, default_value_t = 60.0, value_parser = not_negative)]
    pub frame_rate: f64,
    /// How positions of meshes are kept, as for build.
    #[arg(long, default_value_t, value_name = "auto|lossless|BITS")]
    pub positions: PositionsRule,
    /// RAM for building.
    #[arg(long, default_value = "256M")]
    pub build_memory: ByteSize,
    /// Draw the bytes read in a frame against the size of the place holders into this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// What all of these measurements have.
    #[command(flatten)]
    pub shared: SharedBenchOptions,
}

/// What is measured unless something else is asked for.
const ALL_BLOCKINGS: [&str; 5] =
    ["levels:3..8", "forest:8K..128K,8", "forest:8K..128K,16", "forest:8K..128K,32", "forest:8K..128K,64"];

impl BlockingBenchOptions {
    /// The blockings asked for, each once.
    pub fn blockings(&self) -> Vec<Blocking> {
        let mut all: Vec<Blocking> = Vec::new();
        for blocking in self.blocking.iter().flat_map(Blockings::all) {
            if !all.contains(blocking) {
                all.push(*blocking);
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn values_as_people_write_them() {
        assert_eq!(blocking("forest:16K,8"), Ok(Blocking::default()));
        assert_eq!(blocking("levels:5"), Ok(Blocking::Levels { levels: 5 }));
        assert_eq!("0.1%".parse(), Ok(ErrorArgument::Percent(0.1)));
        assert_eq!("0".parse(), Ok(ErrorArgument::Units(0.0)));
        assert_eq!("640x480".parse(), Ok(PictureSize { width: 640, height: 480 }));
        let camera = CameraArgument { eye: [-1.0, 2.0, 3.0], target: [0.0, 0.0, 0.5] };
        assert_eq!("-1,2,3,0,0,.5".parse(), Ok(camera));
        assert!(blocking("forest:1,8").is_err() && blocking("levels:99").is_err() && blocking("trees").is_err());
        assert!("-1".parse::<ErrorArgument>().is_err());
        assert!("640".parse::<PictureSize>().is_err());
        assert!("1,2,3".parse::<CameraArgument>().is_err());
        assert_eq!("-1, 0, .5".parse(), Ok(Direction([-1.0, 0.0, 0.5])));
        assert_eq!(finer("2.5"), Ok(2.5));
        for direction in ["1,2", "1,2,3,4", "0,0,0", "1,up,0", "nan,1,1", "inf,0,0"] {
            assert!(direction.parse::<Direction>().is_err(), "{direction}");
        }
        assert!(finer("0.5").is_err() && finer("nan").is_err() && finer("1e7").is_err());
    }
}
