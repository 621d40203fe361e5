//! A display without a screen, Xvfb, for programs with windows: real key and mouse events go in, pictures come out.
//!
//! Events are sent through the extension XTEST, so that programs cannot tell them from those of a keyboard and a mouse.

use std::io::{BufRead, BufReader, IoSlice};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use image::RgbImage;
use x11rb::connection::{Connection, RequestConnection};
use x11rb::protocol::Event;
use x11rb::protocol::xproto::{
    ClientMessageEvent, ConnectionExt, CreateWindowAux, EventMask, ImageFormat, InputFocus, MapState, PropMode,
    SELECTION_NOTIFY_EVENT, SelectionNotifyEvent, WindowClass,
};
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

/// What takes longer than this does not happen.
const PATIENCE: Duration = Duration::from_secs(60);
/// A picture that stays the same for so long is finished.
const REST: Duration = Duration::from_millis(600);
/// What has to be installed.
const INSTALL: &str = "install it: apt-get install xvfb mesa-vulkan-drivers libvulkan1 libegl1 libgl1-mesa-dri libxkbcommon-x11-0 libx11-xcb1 \
                       libxcursor1 libxi6 libxrandr2";

/// The codes of events in the protocol.
const KEY: [u8; 2] = [2, 3];
const BUTTON: [u8; 2] = [4, 5];
const MOTION: u8 = 6;

/// Keys without a letter.
pub mod key {
    /// Escape.
    pub const ESCAPE: u32 = 0xff1b;
    /// Tab.
    pub const TAB: u32 = 0xff09;
    /// Enter.
    pub const ENTER: u32 = 0xff0d;
    /// F12.
    pub const F12: u32 = 0xffc9;
    /// Shift.
    pub const SHIFT: u32 = 0xffe1;
}

/// The buttons of the mouse.
pub mod button {
    /// The left one.
    pub const LEFT: u8 = 1;
    /// The middle one.
    pub const MIDDLE: u8 = 2;
    /// The right one.
    pub const RIGHT: u8 = 3;
    /// The wheel, forwards.
    pub const WHEEL_UP: u8 = 4;
    /// The wheel, backwards.
    pub const WHEEL_DOWN: u8 = 5;
}

/// A display of 1280 × 800 points; gone with this value.
#[derive(Debug)]
pub struct Display {
    server: Child,
    name: String,
    connection: RustConnection,
    root: u32,
    xtest: u8,
    /// Of each key, its symbols, and the code of the first.
    symbols: (u8, Vec<Vec<u32>>),
}

impl Display {
    /// Starts one under a free number.
    pub fn start() -> Self {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp", "-noreset"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|error| panic!("cannot start Xvfb ({error}); {INSTALL}"));
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        let name = format!(":{}", number.trim());
        let (connection, screen) = x11rb::connect(Some(&name)).unwrap();
        let setup = connection.setup();
        let root = setup.roots[screen].root;
        let (first, last) = (setup.min_keycode, setup.max_keycode);
        let mapping = connection.get_keyboard_mapping(first, last - first + 1).unwrap().reply().unwrap();
        let symbols = mapping.keysyms.chunks(mapping.keysyms_per_keycode.into()).map(<[u32]>::to_vec).collect();
        let xtest = connection.extension_information("XTEST").unwrap().expect("Xvfb has XTEST").major_opcode;
        Display { server, name, connection, root, xtest, symbols: (first, symbols) }
    }

    /// Has a program draw its windows here, with the processor.
    pub fn lend(&self, command: &mut Command) {
        let drivers = std::fs::read_dir("/usr/share/vulkan/icd.d").into_iter().flatten().flatten();
        let driver: Option<PathBuf> = drivers
            .map(|entry| entry.path())
            .find(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("lvp_icd")));
        let driver = driver.unwrap_or_else(|| panic!("there is no Vulkan driver for the processor; {INSTALL}"));
        command.env("DISPLAY", &self.name).env("VK_ICD_FILENAMES", &driver).env("VK_DRIVER_FILES", driver);
        command.env("WGPU_BACKEND", "vulkan").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    }

    /// The window that is open; waits for it.
    fn window(&self) -> u32 {
        let start = Instant::now();
        let is_seen = |window: &u32| {
            let attributes = self.connection.get_window_attributes(*window).unwrap().reply();
            attributes.is_ok_and(|attributes| attributes.map_state == MapState::VIEWABLE)
        };
        loop {
            let windows = self.connection.query_tree(self.root).unwrap().reply().unwrap().children;
            if let Some(window) = windows.into_iter().find(is_seen) {
                return window;
            }
            assert!(start.elapsed() < PATIENCE, "no window opens");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Gives the keys to the window that is open, as a window manager would.
    pub fn focus(&self) {
        let set = self.connection.set_input_focus(InputFocus::PARENT, self.window(), x11rb::CURRENT_TIME);
        set.unwrap().check().unwrap();
    }

    /// Drops a file onto the window, as a file manager does by the protocol XDND.
    pub fn drop_file(&self, path: &Path) {
        let (connection, target) = (&self.connection, self.window());
        let atom = |name: &str| connection.intern_atom(false, name.as_bytes()).unwrap().reply().unwrap().atom;
        let source = connection.generate_id().unwrap();
        let class = WindowClass::INPUT_OUTPUT;
        let created =
            connection.create_window(0, source, self.root, -2, -2, 1, 1, 0, class, 0, &CreateWindowAux::new());
        created.unwrap().check().unwrap();
        let (selection, list) = (atom("XdndSelection"), atom("text/uri-list"));
        connection.set_selection_owner(source, selection, x11rb::CURRENT_TIME).unwrap().check().unwrap();
        let send = |name: &str, data: [u32; 5]| {
            let message = ClientMessageEvent::new(32, target, atom(name), data);
            connection.send_event(false, target, EventMask::NO_EVENT, message).unwrap().check().unwrap();
        };
        send("XdndEnter", [source, 5 << 24, list, 0, 0]);
        send("XdndPosition", [source, 0, 640 << 16 | 400, x11rb::CURRENT_TIME, atom("XdndActionCopy")]);
        let start = Instant::now();
        loop {
            match connection.poll_for_event().unwrap() {
                Some(Event::SelectionRequest(asked)) => {
                    let address = format!("file://{}\r\n", path.display());
                    let mode = PropMode::REPLACE;
                    let written =
                        connection.change_property8(mode, asked.requestor, asked.property, list, address.as_bytes());
                    written.unwrap().check().unwrap();
                    let answer = SelectionNotifyEvent {
                        response_type: SELECTION_NOTIFY_EVENT,
                        sequence: 0,
                        time: asked.time,
                        requestor: asked.requestor,
                        selection,
                        target: list,
                        property: asked.property,
                    };
                    let sent = connection.send_event(false, asked.requestor, EventMask::NO_EVENT, answer);
                    sent.unwrap().check().unwrap();
                    return send("XdndDrop", [source, 0, x11rb::CURRENT_TIME, 0, 0]);
                }
                Some(_) => (),
                None => std::thread::sleep(Duration::from_millis(10)),
            }
            assert!(start.elapsed() < PATIENCE, "nobody takes what is dropped");
        }
    }

    /// Sends an event: the request `FakeInput` of XTEST.
    fn send(&self, kind: u8, detail: u8, [x, y]: [i16; 2]) {
        let mut request = [0_u8; 36];
        (request[0], request[1]) = (self.xtest, 2);
        request[2..4].copy_from_slice(&9_u16.to_ne_bytes());
        (request[4], request[5]) = (kind, detail);
        request[12..16].copy_from_slice(&self.root.to_ne_bytes());
        request[24..26].copy_from_slice(&x.to_ne_bytes());
        request[26..28].copy_from_slice(&y.to_ne_bytes());
        self.connection.send_request_without_reply(&[IoSlice::new(&request)], Vec::new()).unwrap();
        self.connection.flush().unwrap();
        // What a hand does takes its time.
        std::thread::sleep(Duration::from_millis(20));
    }

    fn code(&self, symbol: u32) -> u8 {
        let (first, symbols) = &self.symbols;
        let place = symbols.iter().position(|symbols| symbols.contains(&symbol));
        first + place.unwrap_or_else(|| panic!("no key has the symbol {symbol:#x}")) as u8
    }

    /// Presses a key, by its symbol: for a letter, the letter's own number.
    pub fn press(&self, symbol: u32) {
        self.send(KEY[0], self.code(symbol), [0; 2]);
    }

    /// Lets it go.
    pub fn release(&self, symbol: u32) {
        self.send(KEY[1], self.code(symbol), [0; 2]);
    }

    /// Both.
    pub fn tap(&self, symbol: u32) {
        self.press(symbol);
        self.release(symbol);
    }

    /// Types a letter.
    pub fn letter(&self, letter: char) {
        self.tap(letter.into());
    }

    /// Moves the mouse to a place.
    pub fn move_to(&self, place: [i16; 2]) {
        self.send(MOTION, 0, place);
    }

    /// Presses a button of the mouse, and lets it go.
    pub fn click(&self, button: u8) {
        self.send(BUTTON[0], button, [0; 2]);
        self.send(BUTTON[1], button, [0; 2]);
    }

    /// Drags from one place to the other, in some steps.
    pub fn drag(&self, button: u8, from: [i16; 2], to: [i16; 2]) {
        self.drag_slowly(button, from, to, Duration::ZERO);
    }

    /// The same with a pause before each step, so that each is seen.
    pub fn drag_slowly(&self, button: u8, from: [i16; 2], to: [i16; 2], pause: Duration) {
        let send = |kind, place| {
            std::thread::sleep(pause);
            self.send(kind, button, place);
        };
        self.move_to(from);
        send(BUTTON[0], [0; 2]);
        for step in 1..=8 {
            std::thread::sleep(pause);
            self.move_to([0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * step / 8));
        }
        send(BUTTON[1], [0; 2]);
    }

    /// What is seen.
    pub fn picture(&self) -> RgbImage {
        let geometry = self.connection.get_geometry(self.root).unwrap().reply().unwrap();
        let (width, height) = (geometry.width, geometry.height);
        let image = self.connection.get_image(ImageFormat::Z_PIXMAP, self.root, 0, 0, width, height, u32::MAX);
        let data = image.unwrap().reply().unwrap().data;
        let colours = data.chunks_exact(4).flat_map(|point| [point[2], point[1], point[0]]).collect();
        RgbImage::from_raw(width.into(), height.into(), colours).unwrap()
    }

    /// Waits until the picture is as it should be, and returns it then.
    pub fn wait_until(&self, what: &str, is_so: impl Fn(&RgbImage) -> bool) -> RgbImage {
        let start = Instant::now();
        loop {
            let picture = self.picture();
            if is_so(&picture) {
                return picture;
            }
            if start.elapsed() > PATIENCE {
                let kept = std::env::temp_dir().join("vdt-view-failed.png");
                picture.save(&kept).unwrap();
                panic!("{what}: never; what is seen instead is in {}", kept.display());
            }
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Waits until the picture does not change any more.
    pub fn finished_picture(&self) -> RgbImage {
        let start = Instant::now();
        let (mut last, mut since) = (self.picture(), Instant::now());
        while since.elapsed() < REST {
            assert!(start.elapsed() < PATIENCE, "the picture does not come to rest");
            std::thread::sleep(Duration::from_millis(30));
            let picture = self.picture();
            if picture != last {
                (last, since) = (picture, Instant::now());
            }
        }
        last
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
