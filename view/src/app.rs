//! The window's life: files are opened, events come in, and frames are drawn when something has changed.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use render::gpu::SceneOptions;
use storage::{Disk, LocalDisk};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{ElementState, KeyEvent, MouseButton, MouseScrollDelta, StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::ModifiersState;
use winit::window::{Window, WindowId};

use crate::canvas::{Canvas, Sheet};
use crate::controls::Flight;
use crate::frame_times::FrameTimes;
use crate::interface::Interface;
use crate::keys::{Action, Keys};
use crate::last_view::{Identity, LastViews};
use crate::notes::Notes;
use crate::overlay::{Figures, Overlay, Ranges, Scenery};
use crate::screenshot::Screenshot;
use crate::session::{Picture, Session, Settings};
use crate::{Opened, Opener, Progress, Summary, ViewError, ViewOptions};

/// What the window is called before there is a file.
const TITLE: &str = "vdt view";
/// How often the opening thread tells how far it is.
const TOLD_EVERY: Duration = Duration::from_millis(50);
/// After what time a window that could not be drawn in is tried again.
const TRIED_AGAIN: Duration = Duration::from_millis(50);
/// How often the RAM of the program is asked for.
const RESIDENT_EVERY: Duration = Duration::from_millis(250);
/// The most time that a frame of a flight counts for, in seconds: after a pause it goes on, and does not jump.
const LONGEST_STEP: f64 = 0.1;
/// What a key of flight counts for that has just been pressed, in seconds.
const FIRST_STEP: f64 = 1.0 / 60.0;
/// Within what time, and how near, a second click makes a double click; the distance in points of the screen.
const DOUBLE_CLICK: (Duration, f64) = (Duration::from_millis(400), 6.0);
/// Points that a touch pad moves for one step of a wheel.
const POINTS_PER_STEP: f64 = 40.0;
/// What a new frame has to the rate that is shown.
const RATE_SHARE: f64 = 0.1;
/// What is offered of RAM where the machine does not tell how much it has.
const USUAL_MEMORY: u64 = 4 << 30;

/// What the opening thread tells.
#[derive(Debug)]
enum Event {
    Progress(Progress),
    Opened(Result<Box<Opened>, String>),
}

/// What is in the window.
#[derive(Debug)]
enum Stage {
    Nothing,
    Opening { path: PathBuf, progress: Option<Progress> },
    Looking(Box<Session>),
}

/// What the mouse does while a button is held.
#[derive(Debug, Clone, Copy)]
enum Drag {
    Orbit,
    Pan,
    LookAround,
}

#[derive(Debug, Default)]
struct Mouse {
    place: [f64; 2],
    drag: Option<(Drag, Picture, MouseButton)>,
    last_click: Option<(Instant, [f64; 2])>,
}

/// The window with what draws in it.
struct Screen {
    // In this order they go.
    interface: Interface,
    canvas: Canvas,
}

struct App {
    options: ViewOptions,
    opener: Arc<dyn Opener>,
    proxy: EventLoopProxy<Event>,
    disk: Arc<dyn Disk>,
    last_views: Option<LastViews>,
    begin: Instant,
    screen: Option<Screen>,
    stage: Stage,
    settings: Settings,
    overlay: Overlay,
    notes: Notes,
    keys: Keys,
    modifiers: ModifiersState,
    mouse: Mouse,
    wants_screenshot: bool,
    /// Up to when keys of flight were heeded, while any is held.
    flown_until: Option<Instant>,
    /// When the last frame was begun, where the next one was to follow at once.
    last_frame: Option<Instant>,
    frame_ms: f64,
    frame_rate: Option<f64>,
    frame_times: FrameTimes,
    /// When the RAM of the program was asked for, and what it was.
    resident: (Option<Instant>, Option<u64>),
    /// The most RAM that is offered.
    most_memory: u64,
    /// When the next frame is due though nothing happens.
    wake_at: Option<Instant>,
    summary: Summary,
    failure: Option<ViewError>,
}

/// Opens a window, and returns when it is closed.
pub fn run(options: ViewOptions, opener: Arc<dyn Opener>) -> Result<Summary, ViewError> {
    let begin = Instant::now();
    let event_loop = EventLoop::<Event>::with_user_event().build()?;
    let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
    let last_views = options.state_folder.clone().map(|folder| LastViews::in_folder(disk.clone(), folder));
    let settings = Settings { pixels: options.pixels, memory: options.memory, max_triangles: options.max_triangles };
    let mut app = App {
        options,
        opener,
        proxy: event_loop.create_proxy(),
        disk,
        last_views,
        begin,
        screen: None,
        stage: Stage::Nothing,
        settings,
        overlay: Overlay::default(),
        notes: Notes::default(),
        keys: Keys::default(),
        modifiers: ModifiersState::default(),
        mouse: Mouse::default(),
        wants_screenshot: false,
        flown_until: None,
        last_frame: None,
        frame_ms: 0.0,
        frame_rate: None,
        frame_times: FrameTimes::default(),
        resident: (None, None),
        most_memory: storage::usage::machine_bytes().map_or(USUAL_MEMORY, |bytes| bytes / 2),
        wake_at: None,
        summary: Summary::default(),
        failure: None,
    };
    event_loop.run_app(&mut app)?;
    match app.failure {
        Some(failure) => Err(failure),
        None => Ok(app.summary),
    }
}

impl Screen {
    fn open(event_loop: &ActiveEventLoop, [width, height]: [u32; 2]) -> Result<Self, ViewError> {
        let attributes =
            Window::default_attributes().with_title(TITLE).with_inner_size(LogicalSize::new(width, height));
        let window = Arc::new(event_loop.create_window(attributes)?);
        let canvas = Canvas::new(event_loop, window.clone())?;
        let interface = Interface::new(event_loop, &window, canvas.gpu(), canvas.format());
        Ok(Screen { interface, canvas })
    }
}

impl ApplicationHandler<Event> for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.screen.is_some() {
            return;
        }
        match Screen::open(event_loop, self.options.size) {
            Ok(screen) => {
                self.summary.renderer = screen.canvas.gpu().name().to_owned();
                self.summary.is_processor = screen.canvas.gpu().is_processor();
                self.screen = Some(screen);
            }
            Err(error) => {
                self.failure = Some(error);
                event_loop.exit();
                return;
            }
        }
        if let Some(file) = self.options.file.clone() {
            self.open(file);
        }
        self.redraw();
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if matches!(cause, StartCause::ResumeTimeReached { .. }) {
            self.wake_at = None;
            self.redraw();
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, event: Event) {
        match event {
            Event::Progress(told) => {
                if let Stage::Opening { progress, .. } = &mut self.stage {
                    *progress = Some(told);
                }
            }
            Event::Opened(Ok(opened)) => self.look_at(*opened),
            Event::Opened(Err(problem)) => self.cannot_open(problem),
        }
        self.redraw();
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(screen) = &mut self.screen else { return };
        let is_for_overlay = !matches!(event, WindowEvent::KeyboardInput { .. } | WindowEvent::RedrawRequested)
            || screen.interface.takes_keys();
        if is_for_overlay && screen.interface.tell(screen.canvas.window(), &event) {
            self.redraw();
        }
        match event {
            WindowEvent::CloseRequested => self.quit(event_loop),
            WindowEvent::DroppedFile(path) => self.open(path),
            WindowEvent::RedrawRequested => self.draw(event_loop),
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } | WindowEvent::Occluded(false) => {
                self.redraw();
            }
            WindowEvent::Focused(false) => {
                self.keys.release_all();
                self.flown_until = None;
                self.mouse.drag = None;
            }
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            // A key that was held when the window came up was meant for another one.
            WindowEvent::KeyboardInput { event, is_synthetic, .. }
                if !is_synthetic || event.state == ElementState::Released =>
            {
                self.key(event_loop, event);
            }
            WindowEvent::MouseInput { state, button, .. } => self.button(state, button),
            WindowEvent::CursorMoved { position, .. } => self.move_mouse([position.x, position.y]),
            WindowEvent::MouseWheel { delta, .. } => self.turn_wheel(delta),
            _ => (),
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        event_loop.set_control_flow(self.wake_at.map_or(ControlFlow::Wait, ControlFlow::WaitUntil));
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        self.leave();
        // While the display is still there.
        self.stage = Stage::Nothing;
        self.screen = None;
    }
}

impl App {
    fn redraw(&self) {
        if let Some(screen) = &self.screen {
            screen.canvas.window().request_redraw();
        }
    }

    /// Changes something that the picture of the model shows.
    fn session(&mut self) -> Option<&mut Session> {
        match &mut self.stage {
            Stage::Looking(session) => Some(session),
            Stage::Nothing | Stage::Opening { .. } => None,
        }
    }

    /// Tells of what went wrong, in the window and to whoever started the program.
    fn fail(&mut self, problem: String) {
        if self.notes.all().iter().all(|note| note.text != problem) {
            (self.options.tell)(&problem);
        }
        self.notes.error(problem);
    }

    fn open(&mut self, path: PathBuf) {
        if let Stage::Opening { path: other, .. } = &self.stage {
            let text = format!("{} has to wait: {} is being opened", name_of(&path), name_of(other));
            self.notes.news(text, Instant::now());
            return;
        }
        self.leave();
        self.notes.clear();
        if let Some(problem) = self.summary.unopened.take() {
            (self.options.tell)(&problem);
        }
        if let Some(screen) = &self.screen {
            screen.canvas.window().set_title(&name_of(&path));
        }
        self.stage = Stage::Opening { path: path.clone(), progress: None };
        let (opener, proxy) = (self.opener.clone(), self.proxy.clone());
        let work = move || {
            let mut last_told: Option<Instant> = None;
            let teller = proxy.clone();
            let mut tell = move |progress| {
                if last_told.is_none_or(|last| last.elapsed() >= TOLD_EVERY) {
                    last_told = Some(Instant::now());
                    // Where there is no window any more, there is nobody to tell.
                    let _ = teller.send_event(Event::Progress(progress));
                }
            };
            // However it ends, the window is told.
            let opened = catch_unwind(AssertUnwindSafe(|| opener.open(&path, &mut tell)));
            let opened = opened.unwrap_or_else(|_| {
                Err(format!(
                    "{}: opening it failed in an unforeseen way; what standard error says helps to find out why",
                    path.display()
                ))
            });
            let _ = proxy.send_event(Event::Opened(opened.map(Box::new)));
        };
        if let Err(error) = std::thread::Builder::new().name("opening".into()).spawn(work) {
            self.cannot_open(format!("cannot start a thread to open the file: {error}"));
        }
        self.redraw();
    }

    fn cannot_open(&mut self, problem: String) {
        self.stage = Stage::Nothing;
        if let Some(screen) = &self.screen {
            screen.canvas.window().set_title(TITLE);
        }
        // What becomes of the program says it at the end, unless another file is opened until then.
        self.notes.error(problem.clone());
        self.summary.unopened = Some(problem);
    }

    fn look_at(&mut self, Opened { model, notes }: Opened) {
        let Some(screen) = &self.screen else { return };
        let size = screen.canvas.size().unwrap_or(self.options.size);
        let scene_options = SceneOptions {
            memory: self.options.gpu_memory,
            format: screen.canvas.format(),
            size,
            most_buffer_bytes: None,
        };
        let identity = Identity::of(&model);
        let path = model.path().to_path_buf();
        let model_triangles = model.header().triangle_count.into();
        let last = match self.last_views.as_ref().map(|views| views.read(&identity)) {
            Some(Ok(last)) => last,
            Some(Err(error)) => {
                self.notes.news(error.to_string(), Instant::now());
                None
            }
            None => None,
        };
        // It is of the first file only.
        let camera = self.options.camera.take();
        match Session::begin(screen.canvas.gpu(), model, scene_options, self.settings, size, (camera, last)) {
            Ok(session) => {
                self.summary.model = Some(path);
                self.summary.model_triangles = model_triangles;
                session.problems().iter().for_each(|problem| self.notes.error(problem.clone()));
                self.stage = Stage::Looking(Box::new(session));
                self.last_frame = None;
                notes.into_iter().for_each(|note| self.notes.news(note, Instant::now()));
            }
            Err(error) => self.cannot_open(error.to_string()),
        }
    }

    /// The model is not looked at any more: what is to be kept of that is kept.
    fn leave(&mut self) {
        if matches!(&self.stage, Stage::Opening { progress: Some(_), .. }) {
            self.summary.is_building = true;
        }
        let is_recording = self.session().is_some_and(|session| session.recorded().is_some());
        if is_recording {
            self.record();
        }
        let Stage::Looking(session) = std::mem::replace(&mut self.stage, Stage::Nothing) else { return };
        let (totals, statistics) = (session.totals(), session.statistics());
        let summary = &mut self.summary;
        summary.adapts += totals.adapts;
        summary.misses += totals.misses;
        summary.reads += totals.reads;
        summary.bytes_read += totals.bytes_read;
        summary.uploaded_bytes += totals.uploaded_bytes;
        summary.triangles = statistics.triangles;
        summary.pixels_drawn = statistics.pixels_drawn;
        summary.budget_bytes = session.budget_bytes();
        summary.gpu_bytes = session.gpu_bytes();
        summary.is_settled = session.is_settled();
        summary.frame_ms_p50 = self.frame_times.percentile(50.0);
        summary.frame_ms_p99 = self.frame_times.percentile(99.0);
        let kept =
            self.last_views.as_ref().map(|views| views.keep(&Identity::of(session.model()), &session.last_view()));
        if let Some(Err(error)) = kept {
            self.fail(format!("the view is not kept for the next time: {error}"));
        }
    }

    fn quit(&mut self, event_loop: &ActiveEventLoop) {
        event_loop.exit();
    }

    fn flight(&self) -> Flight {
        self.keys.flight(self.modifiers.shift_key())
    }

    /// Flies for the time since the last time, with the keys that were held since.
    fn fly(&mut self, now: Instant) {
        let flight = self.flight();
        let since = self.flown_until.replace(now).map_or(0.0, |last| (now - last).as_secs_f64());
        if let Some(session) = self.session() {
            session.fly(flight, since.min(LONGEST_STEP));
        }
        if flight.is_still() {
            self.flown_until = None;
        }
    }

    fn key(&mut self, event_loop: &ActiveEventLoop, event: KeyEvent) {
        self.fly(Instant::now());
        if event.state == ElementState::Released {
            self.keys.release(event.physical_key);
            return;
        }
        let is_for_overlay = self.screen.as_ref().is_some_and(|screen| screen.interface.takes_keys());
        if is_for_overlay || event.repeat || self.modifiers.control_key() || self.modifiers.alt_key() {
            return;
        }
        let looks_around = matches!(self.mouse.drag, Some((Drag::LookAround, ..)));
        let before = self.flight();
        match self.keys.press(&event.logical_key, event.physical_key, looks_around) {
            Some(Action::Quit) => return self.quit(event_loop),
            Some(action) => self.act(action),
            None => {
                // A key that is let go at once moves a little, too.
                let flight = self.flight();
                if flight != before
                    && let Some(session) = self.session()
                {
                    session.fly(flight, FIRST_STEP);
                }
                self.flown_until = Some(Instant::now());
            }
        }
        self.redraw();
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Help => self.overlay.help = !self.overlay.help,
            Action::Hide => self.overlay.is_hidden = !self.overlay.is_hidden,
            Action::Record => self.record(),
            Action::Screenshot => self.wants_screenshot = true,
            Action::Edges | Action::Levels | Action::Boxes | Action::Freeze | Action::Corner | Action::Reset => {
                let Some(session) = self.session() else { return };
                session.touch();
                match action {
                    Action::Edges => session.style.edges = !session.style.edges,
                    Action::Levels => session.style.levels = !session.style.levels,
                    Action::Boxes => session.style.boxes = !session.style.boxes,
                    Action::Freeze => session.toggle_frozen(),
                    Action::Corner => session.toggle_corner(),
                    _ => session.reset(),
                }
            }
            Action::Quit => (),
        }
    }

    /// Begins to record a path, or ends that.
    fn record(&mut self) {
        let disk = self.disk.clone();
        let Some(session) = self.session() else { return };
        let was_recording = session.recorded().is_some();
        match session.toggle_recording(&disk) {
            Ok(Some(path)) => {
                self.notes.news(format!("recorded: {}", path.display()), Instant::now());
                self.summary.paths.push(path);
            }
            Ok(None) if was_recording => self.notes.news("nothing was recorded", Instant::now()),
            Ok(None) => self.notes.news("recording: R ends it", Instant::now()),
            Err(error) => self.fail(format!("the path is not recorded: {error}")),
        }
    }

    fn button(&mut self, state: ElementState, button: MouseButton) {
        if state == ElementState::Released {
            if self.mouse.drag.is_some_and(|(_, _, dragging)| dragging == button) {
                self.mouse.drag = None;
            }
            return;
        }
        let place = self.mouse.place;
        if self.screen.as_ref().is_none_or(|screen| screen.interface.covers(place)) {
            return;
        }
        let is_shifted = self.modifiers.shift_key();
        let Some(session) = self.session() else { return };
        let picture = session.picture_at(place);
        let drag = match button {
            MouseButton::Left if is_shifted => Drag::Pan,
            MouseButton::Left => Drag::Orbit,
            MouseButton::Middle => Drag::Pan,
            MouseButton::Right => Drag::LookAround,
            _ => return,
        };
        self.mouse.drag = Some((drag, picture, button));
        if button == MouseButton::Left && !is_shifted {
            self.click(place);
        }
    }

    /// Puts the pivot at the surface with the second click of two.
    fn click(&mut self, place: [f64; 2]) {
        let now = Instant::now();
        let (within, near) = DOUBLE_CLICK;
        let is_second = self
            .mouse
            .last_click
            .is_some_and(|(then, at)| now - then <= within && (at[0] - place[0]).hypot(at[1] - place[1]) <= near);
        self.mouse.last_click = (!is_second).then_some((now, place));
        if is_second {
            let has_met = self.session().is_some_and(|session| session.pick(place));
            let text = if has_met { "the pivot is here" } else { "there is no surface here to put the pivot on" };
            self.notes.news(text, now);
            self.redraw();
        }
    }

    fn move_mouse(&mut self, place: [f64; 2]) {
        let from = std::mem::replace(&mut self.mouse.place, place);
        let Some((drag, picture, _)) = self.mouse.drag else { return };
        let Some(session) = self.session() else { return };
        let height = f64::from(session.rectangle(picture)[3]).max(1.0);
        let (right, down) = ((place[0] - from[0]) / height, (place[1] - from[1]) / height);
        let controls = session.controls(picture);
        match drag {
            Drag::Orbit => controls.orbit(right, down),
            Drag::Pan => controls.pan(right, down),
            Drag::LookAround => controls.look_around(right, down),
        }
        self.redraw();
    }

    fn turn_wheel(&mut self, delta: MouseScrollDelta) {
        let place = self.mouse.place;
        if self.screen.as_ref().is_none_or(|screen| screen.interface.covers(place)) {
            return;
        }
        let steps = match delta {
            MouseScrollDelta::LineDelta(_, lines) => lines.into(),
            MouseScrollDelta::PixelDelta(points) => points.y / POINTS_PER_STEP,
        };
        let Some(session) = self.session() else { return };
        let picture = session.picture_at(place);
        let cursor = session.place_in(picture, place);
        session.controls(picture).zoom(steps, cursor);
        self.redraw();
    }

    /// Draws a frame, and says when the next one is due.
    fn draw(&mut self, event_loop: &ActiveEventLoop) {
        let Some(screen) = &mut self.screen else { return };
        let sheet = match screen.canvas.sheet() {
            Sheet::Ready(sheet) => sheet,
            Sheet::Later => {
                self.wake_at = Some(Instant::now() + TRIED_AGAIN);
                return;
            }
            Sheet::Hidden => {
                self.last_frame = None;
                return;
            }
        };
        let now = Instant::now();
        let size = [sheet.texture.width(), sheet.texture.height()];
        let since_last = self.last_frame.map(|last| (now - last).as_secs_f64());
        if let Some(seconds) = since_last {
            let rate = 1.0 / seconds.max(1e-6);
            self.frame_rate = Some(self.frame_rate.map_or(rate, |before| before + RATE_SHARE * (rate - before)));
        } else {
            self.frame_rate = None;
        }
        self.fly(now);
        let is_flying = !self.flight().is_still();
        let mut problem = None;
        if let (Stage::Looking(session), Some(screen)) = (&mut self.stage, &self.screen) {
            let stepped = session.set_size(size).and_then(|()| session.step(screen.canvas.gpu(), now));
            problem = stepped.err().map(|error| error.to_string());
        }
        self.notes.tidy(now);
        let changes_after = self.show_overlay(event_loop, now);
        self.paint(sheet);
        if let Some(complaint) = self.screen.as_mut().and_then(|screen| screen.canvas.take_complaint()) {
            self.fail(complaint);
        }
        self.frame_ms = now.elapsed().as_secs_f64() * 1e3;

        let has_failed = problem.is_some();
        if let Some(problem) = problem {
            self.fail(problem);
            self.redraw();
        }
        let mut goes_on = changes_after.is_zero();
        let mut wakes = vec![self.notes.next_change(), now.checked_add(changes_after)];
        if let Stage::Looking(session) = &self.stage {
            self.summary.frames += 1;
            self.frame_times.add(self.frame_ms);
            self.summary.first_picture_seconds.get_or_insert_with(|| self.begin.elapsed().as_secs_f64());
            goes_on |= !has_failed && (session.wants_frame() || is_flying);
            wakes.push(session.next_change());
        }
        self.last_frame = goes_on.then_some(now);
        self.wake_at = wakes.into_iter().flatten().min();
        if goes_on {
            self.redraw();
        }
    }

    /// Makes the overlay, and does what is set there. Returns after what time it changes by itself.
    fn show_overlay(&mut self, event_loop: &ActiveEventLoop, now: Instant) -> Duration {
        let Some(Screen { interface, canvas }) = &mut self.screen else { return Duration::MAX };
        if self.resident.0.is_none_or(|asked| now - asked >= RESIDENT_EVERY) {
            self.resident = (Some(now), storage::usage::resident_bytes());
        }
        if let Stage::Looking(session) = &self.stage {
            self.settings = session.settings();
        }
        let (overlay, notes, stage, settings) = (self.overlay, &mut self.notes, &self.stage, &mut self.settings);
        let (frame_ms, frame_rate, most_memory) = (self.frame_ms, self.frame_rate, self.most_memory);
        let (renderer, allowed, resident) = (&self.summary.renderer, self.options.gpu_memory, self.resident.1);
        let name = if let Stage::Opening { path, .. } = stage { name_of(path) } else { String::new() };
        let changes_after = interface.run(canvas.window(), event_loop, canvas.gpu(), |context| {
            let scenery = match stage {
                Stage::Nothing => Scenery::Nothing,
                Stage::Opening { progress, .. } => Scenery::Opening { name: &name, progress: progress.as_ref() },
                Stage::Looking(session) => Scenery::Model {
                    figures: Figures {
                        frame_ms,
                        frame_rate,
                        statistics: session.statistics(),
                        totals: session.totals(),
                        upload: session.upload(),
                        budget_bytes: session.budget_bytes(),
                        resident_bytes: resident,
                        gpu_bytes: [session.gpu_bytes(), allowed],
                        is_settled: session.is_settled(),
                        is_frozen: session.is_frozen(),
                        recorded: session.recorded(),
                        style: session.style,
                        renderer,
                        corner: session.has_corner().then(|| session.rectangle(Picture::Corner)),
                    },
                    settings: &mut *settings,
                    ranges: Ranges {
                        least_memory: session.least_memory(),
                        most_memory,
                        triangles: session.model().header().triangle_count.into(),
                    },
                },
            };
            overlay.show(context, scenery, notes)
        });
        let settings = self.settings;
        if let Stage::Looking(session) = &mut self.stage
            && let Err(error) = session.set(settings, now)
        {
            self.fail(error.to_string());
        }
        changes_after
    }

    /// Draws the model and the overlay, into the window and, where that is wanted, into a file.
    fn paint(&mut self, sheet: wgpu::SurfaceTexture) {
        let Some(screen) = &mut self.screen else { return };
        let gpu = screen.canvas.gpu();
        let mut draw = |texture: &wgpu::Texture| {
            let target = texture.create_view(&wgpu::TextureViewDescriptor::default());
            let size = [texture.width(), texture.height()];
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            match &mut self.stage {
                Stage::Looking(session) => session.draw(gpu, &mut encoder, &target),
                Stage::Nothing | Stage::Opening { .. } => clear(&mut encoder, &target),
            }
            let before = screen.interface.draw(gpu, &mut encoder, &target, size);
            gpu.queue.submit(before.into_iter().chain([encoder.finish()]));
        };
        let wants_screenshot = std::mem::take(&mut self.wants_screenshot);
        let screenshot = wants_screenshot.then(|| {
            let size = [sheet.texture.width(), sheet.texture.height()];
            let screenshot = Screenshot::new(gpu, size, sheet.texture.format());
            draw(screenshot.texture());
            screenshot
        });
        draw(&sheet.texture);
        screen.canvas.window().pre_present_notify();
        gpu.queue.present(sheet);
        screen.interface.end_frame();
        let path = match &self.stage {
            Stage::Looking(session) => Some(session.model().path().to_path_buf()),
            Stage::Nothing | Stage::Opening { .. } => None,
        };
        let (Some(screenshot), Some(path)) = (screenshot, path) else { return };
        match screenshot.keep(gpu, self.disk.clone(), &path) {
            Ok(path) => {
                self.notes.news(format!("kept: {}", path.display()), Instant::now());
                self.summary.screenshots.push(path);
            }
            Err(error) => self.fail(format!("the picture is not kept: {error}")),
        }
        self.redraw();
    }
}

/// What a file is called in the window.
fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Draws nothing.
fn clear(encoder: &mut wgpu::CommandEncoder, target: &wgpu::TextureView) {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color { r: 0.08, g: 0.085, b: 0.1, a: 1.0 }),
                store: wgpu::StoreOp::Store,
            },
        })],
        ..wgpu::RenderPassDescriptor::default()
    });
}
