//! Cuts of a model to be measured, as mesh files: the same detail everywhere, and what cameras need.
//!
//! The cameras stand at pseudo-random places that depend on the model only. Every other one stands so near that its frustum
//! cuts through the model: levels jump at its edge.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use metanode::header::ModelError;
use metanode::model::Model;
use metanode::{Statement, UniformCut, error_for_triangles};
use navigator::random::Random;
use navigator::{Camera, Dependency, Io, Navigator, NavigatorOptions};
use storage::LocalDisk;
use vdt::mesh::MeshError;
use vdt::mesh::writer::{CoordinateType, MeshLayout, MeshWriter, OutputFormat};

use crate::extract::MOST_FRAMES;

/// The shares of the triangles that cuts have, from the finest to the coarsest.
const SHARES: [f64; 2] = [0.5, 0.005];
/// Triangles of the cut whose vertices cameras look at.
const COARSE: u64 = 2000;
/// Height of the picture, in pixels.
const HEIGHT: u32 = 1080;

/// A kind of cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The same detail everywhere.
    Uniform,
    /// What a camera needs, with the implicit dependency.
    ViewDependent,
}

impl Kind {
    /// Both.
    pub const ALL: [Kind; 2] = [Kind::Uniform, Kind::ViewDependent];

    /// Its name for people and programs.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Uniform => "uniform",
            Kind::ViewDependent => "view-dependent",
        }
    }
}

/// A cut that was written.
#[derive(Debug, Clone, Copy)]
pub struct Cut {
    /// Triangles.
    pub triangles: u64,
    /// What is said of how far the input is from it.
    pub said: Statement,
}

/// Cuts of one model.
#[derive(Debug)]
pub struct Cutter {
    model: Arc<Model>,
    /// Cuts of each kind.
    count: u32,
    /// RAM for a view.
    memory: u64,
    /// Places on the surface, relative to the model's origin.
    places: Vec<[f32; 3]>,
}

impl Cutter {
    /// Opens a model, of which so many cuts of each kind are to be made.
    pub fn open(path: &Path, count: u32, memory: u64) -> Result<Self> {
        let model = Arc::new(Model::open(&LocalDisk, path)?);
        let coarse = UniformCut::new(&model, error_for_triangles(&model, COARSE)?)?;
        let mut places = Vec::with_capacity(coarse.vertex_count() as usize);
        coarse.for_each_vertex(|position| -> Result<(), ModelError> {
            places.push(position);
            Ok(())
        })?;
        drop(coarse);
        Ok(Cutter { model, count, memory, places })
    }

    /// The error of the uniform cut with the share of the triangles that cut number `number` should have.
    fn error_of(&self, number: u32) -> Result<f32> {
        let [first, last] = SHARES.map(f64::ln);
        let along = f64::from(number) / f64::from(self.count.max(2) - 1);
        let share = (first + (last - first) * along).exp();
        Ok(error_for_triangles(&self.model, (f64::from(self.model.header().triangle_count) * share) as u64)?)
    }

    /// Writes cut number `number` of its kind.
    pub fn write(&self, kind: Kind, number: u32, path: &Path) -> Result<Cut> {
        match kind {
            Kind::Uniform => self.uniform(self.error_of(number)?, path),
            Kind::ViewDependent => self.view_dependent(number, path),
        }
    }

    fn placed(&self, position: [f32; 3]) -> [f64; 3] {
        let origin = self.model.header().origin;
        std::array::from_fn(|axis| f64::from(position[axis]) + origin[axis])
    }

    fn uniform(&self, error: f32, path: &Path) -> Result<Cut> {
        let cut = UniformCut::new(&self.model, error)?;
        let mut writer = writer(path, cut.vertex_count(), cut.triangle_count())?;
        cut.for_each_vertex(|position| -> Result<()> { Ok(writer.vertex(self.placed(position), None)?) })?;
        cut.for_each_triangle(|corners| -> Result<()> { Ok(writer.triangle(corners, MeshWriter::NO_MATERIAL)?) })?;
        writer.finish()?;
        Ok(Cut { triangles: cut.triangle_count(), said: cut.statement()? })
    }

    fn view_dependent(&self, number: u32, path: &Path) -> Result<Cut> {
        let (camera, distance) = self.camera(number);
        // What has the error of the uniform cut is as many pixels large at the distance of what the camera looks at.
        let pixels = f64::from(self.error_of(number)?) * f64::from(HEIGHT) / (2.0 * camera.half_height() * distance);
        let options = NavigatorOptions {
            memory: self.memory,
            pixels: pixels as f32,
            height: HEIGHT,
            dependency: Dependency::Implicit,
            io: Io::Sync,
            prefetch: false,
            ..NavigatorOptions::default()
        };
        let mut navigator = Navigator::open(self.model.clone(), options)
            .context("a view-dependent cut has three eighths of --memory")?;
        navigator.run_until_settled(&camera, MOST_FRAMES)?;
        let mut number_of = vec![u64::MAX; navigator.node_bound() as usize];
        let triangles = navigator.triangle_count() as u64;
        let mut writer = writer(path, navigator.active_count() as u64, triangles)?;
        for (number, node) in (0..).zip(navigator.active_nodes()) {
            number_of[node.node as usize] = number;
            writer.vertex(self.placed(node.position), None)?;
        }
        navigator.triangles().try_for_each(|triangle| -> Result<(), MeshError> {
            writer.triangle(triangle.nodes.map(|node| number_of[node as usize]), MeshWriter::NO_MATERIAL)
        })?;
        writer.finish()?;
        Ok(Cut { triangles, said: navigator.statement() })
    }

    /// Where camera number `number` stands, and how far from what it looks at.
    fn camera(&self, number: u32) -> (Camera, f64) {
        let mut random = Random(number.into());
        let place = (random.unit() * self.places.len() as f64) as usize;
        let target = self.placed(self.places.get(place).copied().unwrap_or_default());
        let is_near = number % 2 == 1;
        let distance = match is_near {
            true => 0.05 + 0.25 * random.unit(),
            false => 0.5 + random.unit(),
        } * self.model.header().diagonal();
        // Evenly in all directions.
        let (height, angle) = (2.0 * random.unit() - 1.0, std::f64::consts::TAU * random.unit());
        let width = (1.0 - height * height).sqrt();
        let direction = [width * angle.cos(), width * angle.sin(), height];
        let eye: [f64; 3] = std::array::from_fn(|axis| target[axis] + distance * direction[axis]);
        (Camera::looking_at(eye.into(), target.into(), if is_near { 30.0 } else { 60.0 }), distance)
    }
}

fn writer(path: &Path, vertices: u64, triangles: u64) -> Result<MeshWriter> {
    let layout = MeshLayout {
        vertices,
        triangles,
        coordinates: CoordinateType::Double,
        origin: [0.0; 3],
        comments: Vec::new(),
        attributes: None,
    };
    Ok(MeshWriter::create(Arc::new(LocalDisk), path, OutputFormat::Ply, layout)?)
}
