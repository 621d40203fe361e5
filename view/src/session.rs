//! A model being looked at: the navigator that adapts its front, the scene on the graphics card, and the cameras.
//!
//! The navigator follows the *viewer's* camera, unless it is frozen. With the corner window, the picture shows what an *observer*
//! sees, who has a camera of his own, and the corner what the viewer sees.
//!
//! Another budget of RAM asks for another navigator, as a navigator never allocates after it was opened. The old one goes first,
//! so that the budget holds; its last front stays on the graphics card until the new one has caught up.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec3;
use metanode::model::Model;
use navigator::path::overview;
use navigator::{Camera, FrameStatistics, Navigator, NavigatorError, NavigatorOptions, plan};
use render::gpu::{Gpu, GpuError, Scene, SceneOptions, SceneView, Upload};
use render::{Looks, Projection, Style};
use storage::{Disk, StorageError};
use thiserror::Error;

use crate::controls::{Controls, Flight};
use crate::last_view::LastView;
use crate::pick::nearest;
use crate::recording::Recording;

/// How long a slider of the RAM budget has to be at rest before it acts.
const MEMORY_REST: Duration = Duration::from_millis(150);
/// For how many frames the old front stays after that, unless the new one is finished before.
const MOST_HELD: u32 = 120;
/// With how many frames in which nobody moves a picture is given up that does not come to rest.
const PATIENCE: u32 = 2000;
/// The part of width and height that the corner window takes.
const CORNER_PART: f64 = 1.0 / 3.0;
/// How far it is from the border, in parts of the height.
const CORNER_MARGIN: f64 = 0.02;
/// How far behind the viewer the observer begins, and how far above, in distances of the viewer from the pivot.
const OBSERVER_BEHIND: f64 = 0.25;
const OBSERVER_ABOVE: f64 = 0.7;

/// What can go wrong while a model is looked at.
#[derive(Debug, Error)]
pub enum SessionError {
    /// With the navigation.
    #[error(transparent)]
    Navigator(#[from] NavigatorError),
    /// With the graphics card.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// With a file beside the model.
    #[error(transparent)]
    Storage(#[from] StorageError),
}

/// What whoever sits before the window can set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Error to be seen at most, in pixels.
    pub pixels: f32,
    /// Bytes of RAM for the navigation.
    pub memory: u64,
    /// Most triangles to be drawn.
    pub max_triangles: Option<u64>,
}

/// What has been done since the model was opened.
#[derive(Debug, Clone, Copy, Default)]
pub struct Totals {
    /// Splits and collapses.
    pub adapts: u64,
    /// Splits that had to wait for a page.
    pub misses: u64,
    /// Reads of pages.
    pub reads: u64,
    /// Bytes read.
    pub bytes_read: u64,
    /// Bytes that went to the graphics card.
    pub uploaded_bytes: u64,
}

/// One of the pictures in the window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// The large one.
    Main,
    /// The one in the corner.
    Corner,
}

/// A model being looked at.
#[derive(Debug)]
pub struct Session {
    model: Arc<Model>,
    scene: Scene,
    /// Only missing where one could not be opened.
    navigator: Option<Navigator>,
    settings: Settings,
    /// What images are not drawn, and why.
    problems: Vec<String>,
    /// When the navigator gets another budget.
    reopen_at: Option<Instant>,
    /// For how many frames more the scene does not follow a new navigator.
    held: u32,
    viewer: Controls,
    observer: Option<Controls>,
    is_frozen: bool,
    /// How the model is drawn.
    pub style: Style,
    size: [u32; 2],
    /// With how many frames nothing was touched.
    frames_untouched: u32,
    /// Whether something was touched since the last frame.
    is_touched: bool,
    statistics: FrameStatistics,
    upload: Upload,
    totals: Totals,
    recording: Option<Recording>,
}

impl Session {
    /// Begins to look at a model: from `camera`, else as it was left, else at all of it.
    pub fn begin(
        gpu: &Gpu,
        model: Model,
        scene_options: SceneOptions,
        settings: Settings,
        size: [u32; 2],
        (camera, last): (Option<Camera>, Option<LastView>),
    ) -> Result<Self, SessionError> {
        let model = Arc::new(model);
        let looks = Looks::of(&model, gpu.room_for_textures(settings.memory, scene_options.memory))?;
        let scene = Scene::new(gpu, &model, &looks, scene_options)?;
        let problems = looks.problems().to_vec();
        // The textures are on the graphics card now, and the RAM is for the navigation.
        drop(looks);
        let middle = middle_of(&model);
        let diagonal = model.header().diagonal();
        let viewer = match (camera, last) {
            (Some(camera), _) => Controls::new(camera, camera.target, diagonal),
            (None, Some(LastView { camera, pivot })) => Controls::new(camera, pivot, diagonal),
            (None, None) => Controls::new(overview(&model, size[0], size[1]), middle, diagonal),
        };
        let mut session = Session {
            model,
            scene,
            navigator: None,
            settings,
            problems,
            reopen_at: None,
            held: 0,
            viewer,
            observer: None,
            is_frozen: false,
            style: Style::default(),
            size,
            frames_untouched: 0,
            is_touched: true,
            statistics: FrameStatistics::default(),
            upload: Upload::default(),
            totals: Totals::default(),
            recording: None,
        };
        session.navigator = Some(session.open_navigator()?);
        Ok(session)
    }

    fn open_navigator(&self) -> Result<Navigator, NavigatorError> {
        let options = NavigatorOptions {
            memory: self.settings.memory,
            pixels: self.settings.pixels,
            width: self.size[0],
            height: self.size[1],
            max_triangles: self.triangle_limit(),
            attributes: true,
            ..NavigatorOptions::default()
        };
        Navigator::open(self.model.clone(), options)
    }

    /// What both the settings and the memory of the graphics card allow.
    fn triangle_limit(&self) -> Option<u64> {
        let most = self.scene.most_triangles();
        Some(self.settings.max_triangles.map_or(most, |asked| asked.min(most)))
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// What images are not drawn, and why.
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// What the last frame did.
    pub fn statistics(&self) -> &FrameStatistics {
        &self.statistics
    }

    /// What it brought to the graphics card.
    pub fn upload(&self) -> Upload {
        self.upload
    }

    /// What all frames did together.
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// Bytes of RAM allocated for the navigation.
    pub fn budget_bytes(&self) -> u64 {
        self.navigator.as_ref().map_or(0, Navigator::budget_bytes)
    }

    /// Bytes of the graphics card in use.
    pub fn gpu_bytes(&self) -> u64 {
        self.scene.bytes()
    }

    /// What is set.
    pub fn settings(&self) -> Settings {
        self.settings
    }

    /// The fewest bytes of RAM that work.
    pub fn least_memory(&self) -> u64 {
        plan(&self.model, 0).map_or_else(|error| error.smallest, |budget| budget.bytes)
    }

    /// Whether the picture is finished.
    pub fn is_settled(&self) -> bool {
        self.held == 0 && self.navigator.as_ref().is_some_and(Navigator::settled)
    }

    /// Whether the front follows nobody.
    pub fn is_frozen(&self) -> bool {
        self.is_frozen
    }

    /// Whether the corner window is open.
    pub fn has_corner(&self) -> bool {
        self.observer.is_some()
    }

    /// How many cameras of a path are recorded so far.
    pub fn recorded(&self) -> Option<u64> {
        self.recording.as_ref().map(Recording::cameras)
    }

    /// Where one stands, for the next time.
    pub fn last_view(&self) -> LastView {
        LastView { camera: *self.viewer.camera(), pivot: self.viewer.pivot() }
    }

    /// Takes over what was set. RAM is changed when it has not been set again for a little while.
    pub fn set(&mut self, settings: Settings, now: Instant) -> Result<(), SessionError> {
        let before = std::mem::replace(&mut self.settings, settings);
        if settings == before {
            return Ok(());
        }
        self.is_touched = true;
        if settings.memory != before.memory {
            self.reopen_at = Some(now + MEMORY_REST);
        }
        let limit = self.triangle_limit();
        if let Some(navigator) = &mut self.navigator {
            if settings.pixels != before.pixels {
                navigator.set_pixels(settings.pixels)?;
            }
            if settings.max_triangles != before.max_triangles {
                navigator.set_max_triangles(limit);
            }
        }
        Ok(())
    }

    /// The window has another size now.
    pub fn set_size(&mut self, size: [u32; 2]) -> Result<(), SessionError> {
        if size == self.size {
            return Ok(());
        }
        self.size = size;
        self.is_touched = true;
        if let Some(navigator) = &mut self.navigator {
            navigator.set_size(size[0], size[1])?;
        }
        Ok(())
    }

    /// When something is to happen though nobody touches anything.
    pub fn next_change(&self) -> Option<Instant> {
        self.reopen_at
    }

    /// Whether another frame would show something else.
    pub fn wants_frame(&self) -> bool {
        let follows = !self.is_frozen && self.navigator.is_some();
        self.is_touched || (follows && !self.is_settled() && self.frames_untouched < PATIENCE)
    }

    /// The part of the window that a picture takes: x, y, width and height in points.
    pub fn rectangle(&self, picture: Picture) -> [u32; 4] {
        let [width, height] = self.size;
        match picture {
            Picture::Main => [0, 0, width, height],
            Picture::Corner => {
                let part = |side: u32| ((f64::from(side) * CORNER_PART) as u32).max(1);
                let margin = (f64::from(height) * CORNER_MARGIN) as u32;
                let [wide, tall] = [part(width), part(height)];
                [width.saturating_sub(wide + margin), height.saturating_sub(tall + margin), wide, tall]
            }
        }
    }

    /// The picture at a place of the window.
    pub fn picture_at(&self, place: [f64; 2]) -> Picture {
        let [x, y, width, height] = self.rectangle(Picture::Corner).map(f64::from);
        let is_inside = (x..x + width).contains(&place[0]) && (y..y + height).contains(&place[1]);
        if self.has_corner() && is_inside { Picture::Corner } else { Picture::Main }
    }

    /// A place of the window as one of a picture: in half heights from its middle, to the right and upwards.
    pub fn place_in(&self, picture: Picture, [x, y]: [f64; 2]) -> [f64; 2] {
        let [left, top, width, height] = self.rectangle(picture).map(f64::from);
        [(2.0 * (x - left) - width) / height, (height - 2.0 * (y - top)) / height]
    }

    /// What moves the camera of a picture.
    pub fn controls(&mut self, picture: Picture) -> &mut Controls {
        self.is_touched = true;
        match (&mut self.observer, picture) {
            (Some(observer), Picture::Main) => observer,
            _ => &mut self.viewer,
        }
    }

    /// Puts the pivot where the surface is, at a place of the window. False where there is none.
    pub fn pick(&mut self, place: [f64; 2]) -> bool {
        let picture = self.picture_at(place);
        let place = self.place_in(picture, place);
        let origin = DVec3::from_array(self.model.header().origin);
        let controls = *self.controls(picture);
        let (Some(ray), Some(navigator)) = (controls.ray(place), &self.navigator) else { return false };
        let eye = controls.camera().eye;
        let met = nearest(navigator.vertex_stream(), navigator.triangle_stream(), eye - origin, ray);
        if let Some(times) = met {
            self.controls(picture).set_pivot(eye + ray * times);
        }
        met.is_some()
    }

    /// Flies with the viewer for some seconds.
    pub fn fly(&mut self, flight: Flight, seconds: f64) {
        if !flight.is_still() {
            self.controls(Picture::Corner).fly(flight, seconds);
        }
    }

    /// Goes back to where all of the model is seen.
    pub fn reset(&mut self) {
        let camera = overview(&self.model, self.size[0], self.size[1]);
        self.viewer = Controls::new(camera, middle_of(&self.model), self.model.header().diagonal());
        if self.observer.is_some() {
            self.observer = Some(self.observing());
        }
        self.is_touched = true;
    }

    /// Has the front follow the viewer no more, or again.
    pub fn toggle_frozen(&mut self) {
        self.is_frozen = !self.is_frozen;
        self.is_touched = true;
    }

    /// Opens the corner window, or closes it.
    pub fn toggle_corner(&mut self) {
        self.observer = match self.observer {
            Some(_) => None,
            None => Some(self.observing()),
        };
        self.is_touched = true;
    }

    /// An observer behind the viewer and above.
    fn observing(&self) -> Controls {
        let camera = self.viewer.camera();
        let distance = self.viewer.distance();
        let Ok(frame) = camera.frame() else { return self.viewer };
        let vertical = camera.up.normalize_or(frame.up);
        let eye = camera.eye + (vertical * OBSERVER_ABOVE - frame.forward * OBSERVER_BEHIND) * distance;
        let observing = Camera { eye, target: self.viewer.pivot(), ..*camera };
        let observing = if observing.frame().is_ok() { observing } else { *camera };
        Controls::new(observing, self.viewer.pivot(), self.model.header().diagonal())
    }

    /// Something has changed that the picture shows.
    pub fn touch(&mut self) {
        self.is_touched = true;
    }

    /// Begins to record a path, or ends that: the name of the file.
    pub fn toggle_recording(&mut self, disk: &Arc<dyn Disk>) -> Result<Option<PathBuf>, SessionError> {
        self.is_touched = true;
        match self.recording.take() {
            Some(recording) if recording.cameras() == 0 => Ok(None),
            Some(recording) => Ok(Some(recording.finish()?)),
            None => {
                self.recording = Some(Recording::begin(disk.clone(), self.model.path())?);
                Ok(None)
            }
        }
    }

    /// Gives the navigator the RAM that is asked for, if it is time for that. Where it is too little, the least that works.
    fn reopen(&mut self, now: Instant) -> Result<(), SessionError> {
        if self.reopen_at.is_none_or(|at| now < at) {
            return Ok(());
        }
        self.reopen_at = None;
        // Before the new one, so that both together are never more than one.
        self.navigator = None;
        self.navigator = Some(match self.open_navigator() {
            Err(NavigatorError::Budget(error)) => {
                self.settings.memory = error.smallest;
                self.open_navigator()?
            }
            opened => opened?,
        });
        self.held = MOST_HELD;
        self.is_touched = true;
        Ok(())
    }

    /// Makes the next frame: what the navigator draws, and its copy on the graphics card.
    pub fn step(&mut self, gpu: &Gpu, now: Instant) -> Result<(), SessionError> {
        self.frames_untouched = if std::mem::take(&mut self.is_touched) { 0 } else { self.frames_untouched + 1 };
        self.reopen(now)?;
        if let Some(recording) = &mut self.recording
            && let Err(error) = recording.add(self.viewer.camera())
        {
            self.recording = None;
            return Err(error.into());
        }
        let Some(navigator) = &mut self.navigator else { return Ok(()) };
        if self.is_frozen {
            (self.statistics.splits, self.statistics.collapses, self.statistics.misses) = (0, 0, 0);
        } else {
            self.statistics = navigator.frame(self.viewer.camera())?;
            let FrameStatistics { splits, collapses, misses, pool, .. } = &self.statistics;
            self.totals.adapts += splits + collapses;
            self.totals.misses += misses;
            self.totals.reads += pool.reads;
            self.totals.bytes_read += pool.bytes_read;
        }
        if navigator.settled() {
            self.held = 0;
        } else if !self.is_frozen {
            self.held = self.held.saturating_sub(1);
        }
        self.upload = Upload::default();
        if self.held == 0 {
            self.upload = self.scene.update(gpu, navigator, self.style)?;
            self.totals.uploaded_bytes += self.upload.bytes;
        }
        Ok(())
    }

    /// Draws the pictures.
    pub fn draw(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, target: &wgpu::TextureView) {
        let header = self.model.header();
        let view = |controls: &Controls, picture: Picture, style: Style| {
            let rectangle = self.rectangle(picture);
            let [_, _, width, height] = rectangle;
            let projection =
                Projection::new(controls.camera(), header.origin, header.diagonal(), width, height).ok()?;
            Some(SceneView { projection, rectangle, style })
        };
        let pictures = match &self.observer {
            None => [view(&self.viewer, Picture::Main, self.style), None],
            Some(observer) => {
                [view(observer, Picture::Main, self.style), view(&self.viewer, Picture::Corner, Style::default())]
            }
        };
        let views: Vec<SceneView> = pictures.into_iter().flatten().collect();
        self.scene.draw(gpu, encoder, target, self.size, &views);
    }
}

/// The middle of the model's box, in the coordinates of the input file.
fn middle_of(model: &Model) -> DVec3 {
    let header = model.header();
    let corner = |corner: [f32; 3]| DVec3::from_array(corner.map(f64::from));
    DVec3::from_array(header.origin) + (corner(header.minimum) + corner(header.maximum)) / 2.0
}
