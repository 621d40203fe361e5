//! Camera paths: recorded ones, read from a file, and two that are made for a model: an orbit around it and a flight
//! over its surface. The same model gives the same path, on any machine.

use std::f64::consts::TAU;
use std::fmt;
use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::DVec3;
use metanode::chain::PageChain;
use metanode::header::ModelError;
use metanode::model::Model;
use metanode::page::NormalCone;
use storage::{Disk, SequentialReader, StorageError};
use thiserror::Error;

use crate::camera::{Camera, CameraError};

/// Vertical angle of view of the paths made here, in degrees.
pub(crate) const FIELD_OF_VIEW: f64 = 60.0;
/// Distance of an orbit from the middle of the model, in diagonals of its bounding box.
const ORBIT_DISTANCE: f64 = 1.5;
/// Height of an orbit over the middle of the model, in degrees.
const ORBIT_ELEVATION: f64 = 20.0;
/// The direction from which a model is seen as a whole.
const OVERVIEW_FROM: DVec3 = DVec3::new(-0.45, -0.8, 0.4);
/// The part of the picture that the box of the model may take then.
const OVERVIEW_PART: f64 = 0.95;
/// The least distance then, in diagonals.
const OVERVIEW_NEAREST: f64 = 0.1;
/// Most points of the surface that a flight passes.
const TOUR_POINTS: usize = 7;
/// How far above the surface it passes them, in diagonals.
const TOUR_HEIGHT: f64 = 0.04;
/// Parts into which the way from one of them to the next is cut.
const HOPS: u32 = 4;
/// Most points of the surface among which those of the tour are chosen.
const SURFACE_POINTS: usize = 1 << 16;

/// Which path to fly: `orbit:FRAMES`, `flyby:FRAMES`, or the name of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PathSpec {
    /// A text file, one camera a line; `#` begins a comment.
    File(PathBuf),
    /// Once around the middle of the model, at a constant distance.
    Orbit {
        /// How many cameras.
        frames: u32,
    },
    /// In from afar, low over the surface past a few points that lie far apart, and away.
    Flyby {
        /// How many cameras.
        frames: u32,
    },
}

/// What is wrong with a path.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PathError {
    /// The number of frames behind `orbit:` or `flyby:` is not one.
    #[error("`{text}`: behind the colon goes the number of frames, 1 to 10000000, as in orbit:300")]
    Frames {
        /// What was given.
        text: String,
    },
    /// The file cannot be read.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// A line of the file is not a camera.
    #[error("{}: line {line}: {source}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Which line, counted from 1.
        line: usize,
        /// What is wrong with it.
        source: CameraError,
    },
    /// A line of the file cannot be read, or is not text.
    #[error("{}: line {line}: {source}", path.display())]
    Text {
        /// The file.
        path: PathBuf,
        /// Which line, counted from 1.
        line: usize,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file has no camera in it.
    #[error("{}: there is no camera in this file", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The model, for which a path is to be made, cannot be read.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl fmt::Display for PathSpec {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PathSpec::File(path) => write!(out, "{}", path.display()),
            PathSpec::Orbit { frames } => write!(out, "orbit:{frames}"),
            PathSpec::Flyby { frames } => write!(out, "flyby:{frames}"),
        }
    }
}

impl FromStr for PathSpec {
    type Err = PathError;

    fn from_str(text: &str) -> Result<Self, PathError> {
        let frames = |number: &str| match number.parse() {
            Ok(frames @ 1..=10_000_000) => Ok(frames),
            _ => Err(PathError::Frames { text: text.to_owned() }),
        };
        if let Some(number) = text.strip_prefix("orbit:") {
            Ok(PathSpec::Orbit { frames: frames(number)? })
        } else if let Some(number) = text.strip_prefix("flyby:") {
            Ok(PathSpec::Flyby { frames: frames(number)? })
        } else {
            Ok(PathSpec::File(text.into()))
        }
    }
}

impl PathSpec {
    /// The cameras of the path, in the coordinates of the input file. 80 bytes each.
    pub fn cameras(&self, disk: &dyn Disk, model: &Model) -> Result<Vec<Camera>, PathError> {
        match self {
            PathSpec::File(path) => read(disk, path),
            PathSpec::Orbit { frames } => Ok(orbit(&Bounds::of(model), *frames)),
            PathSpec::Flyby { frames } => {
                let points = surface_points(model)?;
                Ok(flyby(&Bounds::of(model), &points, *frames))
            }
        }
    }
}

/// Reads a path file.
fn read(disk: &dyn Disk, path: &Path) -> Result<Vec<Camera>, PathError> {
    let reader = SequentialReader::new(disk.open(path)?);
    let mut cameras = Vec::new();
    for (index, text) in reader.lines().enumerate() {
        let line = index + 1;
        let text = text.map_err(|source| PathError::Text { path: path.into(), line, source })?;
        let camera = text.split('#').next().unwrap_or_default().trim();
        if !camera.is_empty() {
            let camera = camera.parse().map_err(|source| PathError::Line { path: path.into(), line, source })?;
            cameras.push(camera);
        }
    }
    if cameras.is_empty() {
        return Err(PathError::Empty { path: path.into() });
    }
    Ok(cameras)
}

/// The box that a path goes around, in the coordinates of the input file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    /// Its middle.
    pub(crate) center: DVec3,
    /// Length of the diagonal; 1 where the model has no extent.
    pub(crate) diagonal: f64,
}

impl Bounds {
    pub(crate) fn of(model: &Model) -> Self {
        let header = model.header();
        let corner = |corner: [f32; 3]| DVec3::from_array(corner.map(f64::from));
        let diagonal = header.diagonal();
        Bounds {
            center: DVec3::from_array(header.origin) + (corner(header.minimum) + corner(header.maximum)) / 2.0,
            diagonal: if diagonal > 0.0 { diagonal } else { 1.0 },
        }
    }
}

/// A camera that sees all of a model, from the front, above and a little aside, in a picture of `width` × `height` pixels.
pub fn overview(model: &Model, width: u32, height: u32) -> Camera {
    let (bounds, header) = (Bounds::of(model), model.header());
    // The direction alone: added to coordinates that are very large, it would be lost.
    let camera = Camera::looking_at(OVERVIEW_FROM, DVec3::ZERO, FIELD_OF_VIEW);
    let tall = camera.half_height() * OVERVIEW_PART;
    let wide = tall * f64::from(width) / f64::from(height.max(1));
    let extent = |corner: [f32; 3]| DVec3::from_array(header.origin) + DVec3::from_array(corner.map(f64::from));
    let (least, most) = (extent(header.minimum) - bounds.center, extent(header.maximum) - bounds.center);
    // How far the eye has to be for each corner of the box to be in the picture.
    let distance = |corner: DVec3, forward: DVec3, right: DVec3, up: DVec3| {
        (right.dot(corner).abs() / wide).max(up.dot(corner).abs() / tall) - forward.dot(corner)
    };
    let corners = (0..8).map(|at| DVec3::from_array(std::array::from_fn(|axis| [least, most][at >> axis & 1][axis])));
    let frame = camera.frame().ok();
    let distances = frame
        .iter()
        .flat_map(|frame| corners.clone().map(|corner| distance(corner, frame.forward, frame.right, frame.up)));
    let farthest = distances.fold(OVERVIEW_NEAREST * bounds.diagonal, f64::max);
    Camera { eye: bounds.center + OVERVIEW_FROM.normalize() * farthest, target: bounds.center, ..camera }
}

fn orbit(bounds: &Bounds, frames: u32) -> Vec<Camera> {
    let (height, reach) = ORBIT_ELEVATION.to_radians().sin_cos();
    let camera = |frame: u32| {
        let (y, x) = (TAU * f64::from(frame) / f64::from(frames)).sin_cos();
        let direction = DVec3::new(x * reach, y * reach, height);
        let eye = bounds.center + direction * (bounds.diagonal * ORBIT_DISTANCE);
        Camera::looking_at(eye, bounds.center, FIELD_OF_VIEW)
    };
    (0..frames).map(camera).collect()
}

/// A point of the surface with a direction that leads away from it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    /// The point.
    pub(crate) position: DVec3,
    /// Of unit length; `None` where no direction is known.
    pub(crate) away: Option<DVec3>,
}

/// Points of the coarse surface: the roots, and the vertices that the splits in the root pages bear.
pub(crate) fn surface_points(model: &Model) -> Result<Vec<SurfacePoint>, ModelError> {
    let origin = DVec3::from_array(model.header().origin);
    let point = |position: [f32; 3], cone: NormalCone| SurfacePoint {
        position: origin + DVec3::from_array(position.map(f64::from)),
        away: match cone.sine {
            u8::MAX => None,
            _ => DVec3::from_array(cone.axis.map(f64::from)).try_normalize(),
        },
    };
    let mut points: Vec<_> =
        model.roots().iter().take(SURFACE_POINTS).map(|root| point(root.position, root.cone)).collect();
    let mut chain = PageChain::new(model);
    for location in model.root_pages() {
        if points.len() >= SURFACE_POINTS {
            break;
        }
        let page = chain.page(*location, None)?;
        let records = (0..page.counts().records as u16).filter_map(|index| page.record(index));
        points.extend(records.map(|record| {
            let cone = record.born.map_or(NormalCone::EVERYTHING, |born| born.cone);
            point(record.position, cone)
        }));
    }
    Ok(points)
}

/// A few points that lie far apart, in an order that makes a short tour of them.
fn tour(bounds: &Bounds, points: &[SurfacePoint]) -> Vec<SurfacePoint> {
    // Each next one is the farthest from those chosen; the first is the farthest from the middle.
    let mut distances: Vec<f64> = points.iter().map(|point| point.position.distance_squared(bounds.center)).collect();
    let mut chosen: Vec<SurfacePoint> = Vec::new();
    while chosen.len() < TOUR_POINTS {
        let farthest = distances.iter().enumerate().max_by(|left, right| left.1.total_cmp(right.1));
        let Some((farthest, distance)) = farthest else { break };
        if *distance <= 0.0 && !chosen.is_empty() {
            break;
        }
        let next = points[farthest];
        chosen.push(next);
        for (distance, point) in distances.iter_mut().zip(points) {
            let to_next = point.position.distance_squared(next.position);
            *distance = if chosen.len() == 1 { to_next } else { distance.min(to_next) };
        }
    }
    // Nearest neighbour, from the first on; then parts are turned round while that makes it shorter.
    for done in 1..chosen.len() {
        let last = chosen[done - 1].position;
        let distance = |index: &usize| chosen[*index].position.distance_squared(last);
        let nearest = (done..chosen.len()).min_by(|left, right| distance(left).total_cmp(&distance(right)));
        chosen.swap(done, nearest.unwrap_or(done));
    }
    let length = |points: &[SurfacePoint]| -> f64 {
        points.windows(2).map(|pair| pair[0].position.distance(pair[1].position)).sum()
    };
    let mut improved = true;
    while improved {
        improved = false;
        for first in 1..chosen.len() {
            for last in first + 1..chosen.len() {
                let mut turned = chosen.clone();
                turned[first..=last].reverse();
                if length(&turned) < length(&chosen) * (1.0 - 1e-9) {
                    chosen = turned;
                    improved = true;
                }
            }
        }
    }
    chosen
}

/// The tour with stops put in between: the points of the surface that are nearest to the straight way, so that the
/// flight follows the surface instead of cutting through it.
fn along_the_surface(tour: &[SurfacePoint], points: &[SurfacePoint]) -> Vec<SurfacePoint> {
    let mut way: Vec<SurfacePoint> = Vec::new();
    let mut pass = |point: &SurfacePoint| {
        if way.last().is_none_or(|last| last.position != point.position) {
            way.push(*point);
        }
    };
    for (index, from) in tour.iter().enumerate() {
        pass(from);
        let Some(to) = tour.get(index + 1) else { break };
        for part in 1..HOPS {
            let between = from.position.lerp(to.position, f64::from(part) / f64::from(HOPS));
            let distance = |point: &&SurfacePoint| point.position.distance_squared(between);
            if let Some(nearest) = points.iter().min_by(|left, right| distance(left).total_cmp(&distance(right))) {
                pass(nearest);
            }
        }
    }
    way
}

fn flyby(bounds: &Bounds, points: &[SurfacePoint], frames: u32) -> Vec<Camera> {
    let outward = |position: DVec3| (position - bounds.center).try_normalize().unwrap_or(DVec3::Z);
    let way = along_the_surface(&tour(bounds, points), points);
    let lifted = |point: &SurfacePoint| {
        point.position + point.away.unwrap_or_else(|| outward(point.position)) * (bounds.diagonal * TOUR_HEIGHT)
    };
    // Afar is beyond the first and the last point as seen from the middle, and a little upwards.
    let afar = |near: DVec3| {
        let direction = (outward(near) + DVec3::Z / 2.0).normalize_or(DVec3::Z);
        bounds.center + direction * (bounds.diagonal * ORBIT_DISTANCE)
    };
    let mut eyes = vec![afar(way.first().map_or(bounds.center + DVec3::X, |point| point.position))];
    eyes.extend(way.iter().map(lifted));
    eyes.push(afar(way.last().map_or(bounds.center - DVec3::X, |point| point.position)));

    // Each stop has the surface two stops ahead in the middle of the picture; those at the end the middle of the model.
    let mut targets: Vec<DVec3> = way.iter().skip(1).map(|point| point.position).collect();
    targets.resize(eyes.len(), bounds.center);

    // A long way takes longer than a short one, though not in proportion: low over the surface it goes slowly.
    let shares: Vec<f64> = eyes.windows(2).map(|pair| pair[0].distance(pair[1]).sqrt()).collect();
    let whole: f64 = shares.iter().sum();
    let camera = |frame: u32| {
        let mut left = if frames > 1 { f64::from(frame) / f64::from(frames - 1) * whole } else { 0.0 };
        let mut segment = 0;
        while segment + 1 < shares.len() && left > shares[segment] {
            left -= shares[segment];
            segment += 1;
        }
        let part = if shares[segment] > 0.0 { (left / shares[segment]).min(1.0) } else { 0.0 };
        let time = segment as f64 + part;
        let eye = spline(&eyes, time);
        let mut target = spline(&targets, time);
        if eye.distance(target) < bounds.diagonal * 1e-3 {
            target = eye + DVec3::NEG_Z * bounds.diagonal;
        }
        Camera::looking_at(eye, target, FIELD_OF_VIEW)
    };
    (0..frames).map(camera).collect()
}

/// The uniform Catmull-Rom spline through the points, at time 0 at the first, 1 at the second and so on.
fn spline(points: &[DVec3], time: f64) -> DVec3 {
    let segment = (time.floor().max(0.0) as usize).min(points.len().saturating_sub(2));
    let at = |index: usize| points[index.min(points.len() - 1)];
    let (before, from, to, after) = (at(segment.saturating_sub(1)), at(segment), at(segment + 1), at(segment + 2));
    let t = time - segment as f64;
    let (leave, arrive) = ((to - before) / 2.0, (after - from) / 2.0);
    let (t2, t3) = (t * t, t * t * t);
    from * (2.0 * t3 - 3.0 * t2 + 1.0) + leave * (t3 - 2.0 * t2 + t) + to * (3.0 * t2 - 2.0 * t3) + arrive * (t3 - t2)
}

#[cfg(test)]
mod tests {
    use storage::MemoryDisk;

    use super::*;
    use crate::testing;

    fn unit_bounds() -> Bounds {
        Bounds { center: DVec3::new(10.0, 0.0, 0.0), diagonal: 2.0 }
    }

    #[test]
    fn a_path_is_named_by_kind_or_file() {
        assert_eq!("orbit:12".parse::<PathSpec>().unwrap(), PathSpec::Orbit { frames: 12 });
        assert_eq!("flyby:1".parse::<PathSpec>().unwrap(), PathSpec::Flyby { frames: 1 });
        assert_eq!("walk.txt".parse::<PathSpec>().unwrap(), PathSpec::File("walk.txt".into()));
        for text in ["orbit:12", "flyby:1", "walk.txt"] {
            assert_eq!(text.parse::<PathSpec>().unwrap().to_string(), text);
        }
        for wrong in ["orbit:", "orbit:0", "flyby:-3", "flyby:1e3", "orbit:99999999"] {
            assert!(wrong.parse::<PathSpec>().unwrap_err().to_string().contains("number of frames"), "{wrong}");
        }
    }

    #[test]
    fn a_file_has_a_camera_a_line() {
        let disk = MemoryDisk::new();
        disk.insert("path", "# eye target up fov\n1 2 3 4 5 6 0 0 1 60\n\n  7 8 9 0 0 0 0 0 1 45 # there\r\n");
        let cameras = read(&disk, Path::new("path")).unwrap();
        assert_eq!(cameras.len(), 2);
        assert_eq!(cameras[1].eye, DVec3::new(7.0, 8.0, 9.0));

        disk.insert("wrong", "1 2 3 4 5 6 0 0 1 60\n1 2 3\n");
        let message = read(&disk, Path::new("wrong")).unwrap_err().to_string();
        assert!(message.starts_with("wrong: line 2: a camera is ten numbers"), "{message}");
        disk.insert("binary", [b'1', 0xff, b'\n']);
        let message = read(&disk, Path::new("binary")).unwrap_err().to_string();
        assert!(message.starts_with("binary: line 1: "), "{message}");
        disk.insert("empty", "# nothing\n");
        assert!(matches!(read(&disk, Path::new("empty")), Err(PathError::Empty { .. })));
        assert!(read(&disk, Path::new("absent")).unwrap_err().to_string().contains("absent"));
    }

    #[test]
    fn an_orbit_keeps_its_distance() {
        for camera in orbit(&unit_bounds(), 7) {
            assert!((camera.eye.distance(unit_bounds().center) - 3.0).abs() < 1e-9);
            camera.frame().unwrap();
        }
    }

    #[test]
    fn a_spline_goes_through_its_points() {
        let points: Vec<DVec3> = (0..5).map(|index| DVec3::new(f64::from(index * index), 1.0, -2.0)).collect();
        for (index, point) in points.iter().enumerate() {
            assert!(spline(&points, index as f64).distance(*point) < 1e-12);
        }
    }

    #[test]
    fn a_flight_comes_close_to_the_surface_and_leaves() {
        let model = testing::model_of(&testing::sphere_tree(4, 1));
        let disk = MemoryDisk::new();
        let cameras = PathSpec::Flyby { frames: 200 }.cameras(&disk, &model).unwrap();
        assert_eq!(cameras.len(), 200);
        let bounds = Bounds::of(&model);
        let distance = |camera: &Camera| camera.eye.distance(bounds.center) / bounds.diagonal;
        let (first, last) = (distance(&cameras[0]), distance(&cameras[199]));
        assert!(first > 1.0 && last > 1.0, "{first} {last}");
        let nearest = cameras.iter().map(distance).fold(f64::INFINITY, f64::min);
        assert!(nearest < 0.4, "{nearest}");
        for pair in cameras.windows(2) {
            pair[0].frame().unwrap();
            assert!(pair[0].eye.distance(pair[1].eye) < bounds.diagonal * 0.2);
        }
        assert_eq!(cameras, PathSpec::Flyby { frames: 200 }.cameras(&disk, &model).unwrap());
    }

    /// The overview of a mesh with coordinates of 10^17 once looked in no direction at all: it took that from a point one unit away.
    #[test]
    fn an_overview_does_not_depend_on_the_size_of_the_model() {
        let direction = |scale: f32| {
            let mut mesh = testing::Mesh::grid(6, 6, 1);
            mesh.positions
                .iter_mut()
                .for_each(|position| *position = *position * scale + glam::Vec3::splat(5.0 * scale));
            let model = testing::model_of(&mesh.into_tree(1, 3));
            let camera = overview(&model, 640, 480);
            let frame = camera.frame().unwrap();
            assert!(camera.eye.distance(Bounds::of(&model).center) > Bounds::of(&model).diagonal / 2.0);
            frame.forward
        };
        let usual = direction(1.0);
        assert!(usual.distance(-OVERVIEW_FROM.normalize()) < 1e-6);
        for scale in [1e-6, 1e17, 1e24] {
            assert!(direction(scale).distance(usual) < 1e-3, "{scale}");
        }
    }

    #[test]
    fn small_models_have_paths() {
        let disk = MemoryDisk::new();
        for tree in [testing::empty_tree(), testing::triangle_tree()] {
            let model = testing::model_of(&tree);
            for spec in ["orbit:1", "orbit:9", "flyby:1", "flyby:50"] {
                for camera in spec.parse::<PathSpec>().unwrap().cameras(&disk, &model).unwrap() {
                    camera.frame().unwrap();
                }
            }
        }
    }
}
