//! What is over the picture: figures, sliders, the help, messages, and what there is to be seen while there is no model.

use egui::{Align2, Area, Color32, Context, Frame, Id, Margin, Order, Rect, RichText, Slider, Stroke, Ui, Vec2};
use navigator::FrameStatistics;
use render::Style;
use render::gpu::Upload;
use storage::ByteSize;

use crate::Progress;
use crate::keys::HELP;
use crate::notes::Notes;
use crate::session::{Settings, Totals};

/// The errors that the slider goes over, in pixels.
const PIXELS: [f64; 2] = [0.1, 20.0];
/// The fewest triangles that its slider goes to.
const LEAST_TRIANGLES: f64 = 1000.0;
/// How far everything is from the border of the window.
const MARGIN: f32 = 12.0;
/// The most letters of a graphics card's name.
const LONGEST_NAME: usize = 36;
/// How wide text may be before it goes on in the next line.
const WIDTH: f32 = 420.0;
/// What is behind the text: the picture shines through.
const PANEL: Color32 = Color32::from_rgba_premultiplied(14, 15, 18, 215);
const ERROR: Color32 = Color32::from_rgb(255, 120, 100);
const QUIET: Color32 = Color32::from_rgb(150, 155, 165);

/// What the sliders go over.
#[derive(Debug, Clone, Copy)]
pub struct Ranges {
    /// The fewest bytes of RAM that work.
    pub least_memory: u64,
    /// The most that is offered.
    pub most_memory: u64,
    /// Triangles of the model.
    pub triangles: u64,
}

/// What is told of a model being looked at.
#[derive(Debug, Clone, Copy)]
pub struct Figures<'a> {
    /// How long the last frame took, without waiting for the screen, in milliseconds.
    pub frame_ms: f64,
    /// Frames in a second, while one comes after the other.
    pub frame_rate: Option<f64>,
    /// What the last frame did.
    pub statistics: &'a FrameStatistics,
    /// What all of them did.
    pub totals: Totals,
    /// What the last frame brought to the graphics card.
    pub upload: Upload,
    /// Bytes of RAM allocated for the navigation.
    pub budget_bytes: u64,
    /// Bytes of RAM of the whole program.
    pub resident_bytes: Option<u64>,
    /// Bytes of the graphics card in use, and those allowed.
    pub gpu_bytes: [u64; 2],
    /// Whether the picture is finished.
    pub is_settled: bool,
    /// Whether the front follows nobody.
    pub is_frozen: bool,
    /// Cameras recorded so far.
    pub recorded: Option<u64>,
    /// How it is drawn.
    pub style: Style,
    /// What draws.
    pub renderer: &'a str,
    /// Where the corner window is, in points of the screen.
    pub corner: Option<[u32; 4]>,
}

/// What is in the window.
#[derive(Debug)]
pub enum Scenery<'a> {
    /// No model.
    Nothing,
    /// One is being opened or built.
    Opening {
        /// Of which file.
        name: &'a str,
        /// How far that is, where it takes long enough to be told.
        progress: Option<&'a Progress>,
    },
    /// One is being looked at.
    Model {
        /// What is told of it.
        figures: Figures<'a>,
        /// What the sliders set.
        settings: &'a mut Settings,
        /// What they go over.
        ranges: Ranges,
    },
}

/// What of the overlay is seen.
#[derive(Debug, Clone, Copy, Default)]
pub struct Overlay {
    /// Whether the keys are explained.
    pub help: bool,
    /// Whether only the picture is seen.
    pub is_hidden: bool,
}

impl Overlay {
    /// Shows it; what it covers. Errors are there in any case.
    pub fn show(&self, context: &Context, scenery: Scenery<'_>, notes: &mut Notes) -> Vec<Rect> {
        let mut covered = Vec::new();
        match scenery {
            Scenery::Nothing => covered.push(nothing(context)),
            Scenery::Opening { name, progress } => covered.push(opening(context, name, progress)),
            Scenery::Model { figures, settings, ranges } => {
                if let Some(corner) = figures.corner {
                    frame_of_corner(context, corner);
                }
                if !self.is_hidden {
                    covered.push(panel(context, &figures, settings, ranges));
                }
            }
        }
        if self.help && !self.is_hidden {
            covered.push(help(context));
        }
        covered.extend(messages(context, notes, self.is_hidden));
        covered
    }
}

/// A panel at a place of the window; what it covers.
fn place(context: &Context, name: &str, anchor: Align2, offset: [f32; 2], add: impl FnOnce(&mut Ui)) -> Rect {
    let frame = Frame::new().fill(PANEL).inner_margin(Margin::same(10)).corner_radius(6);
    let area = Area::new(Id::unique(name)).anchor(anchor, offset).order(Order::Foreground).constrain(true);
    area.show(context, |ui| frame.show(ui, add)).response.rect
}

fn nothing(context: &Context) -> Rect {
    place(context, "nothing", Align2::CENTER_CENTER, [0.0; 2], |ui| {
        ui.vertical_centered(|ui| {
            ui.heading("Drop a mesh or a model here");
            ui.label("PLY, OBJ, STL, OFF, glTF, or a .vdt file; or name one: vdt view scan.ply");
            ui.label(RichText::new("H help · Esc quit").color(QUIET));
        });
    })
}

fn opening(context: &Context, name: &str, progress: Option<&Progress>) -> Rect {
    place(context, "opening", Align2::CENTER_CENTER, [0.0; 2], |ui| {
        ui.set_width(WIDTH);
        match progress {
            None => {
                ui.heading(format!("Opening {name}"));
            }
            Some(Progress { phase, share }) => {
                ui.heading(format!("Building the model of {name}"));
                ui.label("once: next time it opens at once");
                ui.add(egui::ProgressBar::new(*share as f32).show_percentage());
                ui.label(RichText::new(format!("{phase} · Esc gives it up")).color(QUIET));
            }
        }
    })
}

fn frame_of_corner(context: &Context, [x, y, width, height]: [u32; 4]) {
    let points = |pixels: u32| pixels as f32 / context.pixels_per_point();
    let rectangle = Rect::from_min_size(egui::pos2(points(x), points(y)), Vec2::new(points(width), points(height)));
    let painter = context.layer_painter(egui::LayerId::new(Order::Background, Id::unique("corner")));
    painter.rect_stroke(rectangle, 0, Stroke::new(1.5, Color32::from_gray(200)), egui::StrokeKind::Outside);
}

fn panel(context: &Context, figures: &Figures<'_>, settings: &mut Settings, ranges: Ranges) -> Rect {
    place(context, "figures", Align2::LEFT_TOP, [MARGIN; 2], |ui| {
        egui::Grid::new("figures").num_columns(2).spacing([12.0, 2.0]).show(ui, |ui| {
            for (name, value) in lines(figures, settings.memory, ranges) {
                ui.label(RichText::new(name).color(QUIET));
                ui.label(RichText::new(value).monospace());
                ui.end_row();
            }
        });
        ui.add_space(6.0);
        sliders(ui, settings, ranges);
        ui.add_space(4.0);
        ui.label(RichText::new("H help · Tab hides this").color(QUIET).small());
    })
}

/// The figures, with their names; `memory` is the budget.
fn lines(figures: &Figures<'_>, memory: u64, ranges: Ranges) -> Vec<(&'static str, String)> {
    let Figures { statistics, totals, upload, .. } = figures;
    let rate = figures.frame_rate.map_or(String::new(), |rate| format!(", {rate:.0} a second"));
    let state = match (figures.is_frozen, figures.is_settled) {
        (true, _) => "frozen",
        (false, true) => "yes",
        (false, false) => "no",
    };
    let resident = figures.resident_bytes.map_or(String::new(), |bytes| format!("; program {}", ByteSize(bytes)));
    let [gpu_bytes, gpu_allowed] = figures.gpu_bytes.map(ByteSize);
    vec![
        ("frame", format!("{:.1} ms{rate}", figures.frame_ms)),
        ("triangles", format!("{} of {}", grouped(statistics.triangles), grouped(ranges.triangles))),
        ("error", format!("{:.2} pixels", statistics.pixels_drawn)),
        ("settled", state.into()),
        ("adapts", grouped(statistics.splits + statistics.collapses)),
        ("misses", format!("{}, {} in all", grouped(statistics.misses), grouped(totals.misses))),
        ("RAM", format!("{} of {}{resident}", ByteSize(figures.budget_bytes), ByteSize(memory))),
        ("GPU memory", format!("{gpu_bytes} of {gpu_allowed}")),
        ("disk", format!("{} reads, {}", grouped(totals.reads), ByteSize(totals.bytes_read))),
        ("upload", format!("{} a frame, {} in all", ByteSize(upload.bytes), ByteSize(totals.uploaded_bytes))),
        ("drawn by", shortened(figures.renderer)),
        ("shown", shown(figures)),
    ]
}

/// How the model is drawn, and what becomes of that.
fn shown(figures: &Figures<'_>) -> String {
    let Style { edges, levels, boxes, .. } = figures.style;
    let also = [(edges, ", edges"), (levels, ", levels"), (boxes, ", boxes")];
    let also = also.into_iter().filter_map(|(is_shown, name)| is_shown.then_some(name));
    let recorded = figures.recorded.map(|cameras| format!("; {} cameras recorded", grouped(cameras)));
    ["surface"].into_iter().chain(also).chain(recorded.as_deref()).collect()
}

/// A name that does not make the panel wider than the rest of it does.
fn shortened(name: &str) -> String {
    if name.chars().count() <= LONGEST_NAME {
        return name.into();
    }
    name.chars().take(LONGEST_NAME - 1).chain(['…']).collect()
}

fn sliders(ui: &mut Ui, settings: &mut Settings, ranges: Ranges) {
    ui.spacing_mut().slider_width = 170.0;
    // What was asked for on the command line may lie beyond.
    let pixels = PIXELS[0].min(settings.pixels.into())..=PIXELS[1].max(settings.pixels.into());
    let pixels = (*pixels.start() as f32)..=(*pixels.end() as f32);
    ui.add(Slider::new(&mut settings.pixels, pixels).logarithmic(true).text("pixels of error"));

    let most = ranges.most_memory.max(settings.memory).max(ranges.least_memory + 1);
    let mut memory = settings.memory as f64;
    let slider = Slider::new(&mut memory, ranges.least_memory as f64..=most as f64)
        .logarithmic(true)
        .custom_formatter(|bytes, _| ByteSize(bytes as u64).to_string())
        .custom_parser(|text| text.parse::<ByteSize>().ok().map(|size| size.0 as f64))
        .text("RAM");
    if ui.add(slider).changed() {
        settings.memory = (memory as u64).clamp(ranges.least_memory, most);
    }

    let all = (ranges.triangles as f64).max(LEAST_TRIANGLES);
    let mut triangles = settings.max_triangles.map_or(all, |most| most as f64).min(all);
    let least = LEAST_TRIANGLES.min(triangles);
    let slider = Slider::new(&mut triangles, least..=all)
        .logarithmic(true)
        .custom_formatter(move |value, _| if value >= all { "all".into() } else { grouped(value as u64) })
        .custom_parser(|text| text.replace(',', "").parse().ok())
        .text("triangles at most");
    if ui.add(slider).changed() {
        settings.max_triangles = (triangles < all).then_some(triangles as u64);
    }
}

fn help(context: &Context) -> Rect {
    place(context, "help", Align2::RIGHT_TOP, [-MARGIN, MARGIN], |ui| {
        egui::Grid::new("help").num_columns(2).spacing([14.0, 3.0]).show(ui, |ui| {
            for (key, says) in HELP {
                ui.label(RichText::new(key).strong());
                ui.label(says);
                ui.end_row();
            }
        });
    })
}

fn messages(context: &Context, notes: &mut Notes, errors_only: bool) -> Option<Rect> {
    let shown: Vec<_> =
        notes.all().iter().cloned().enumerate().filter(|(_, note)| note.is_error() || !errors_only).collect();
    if shown.is_empty() {
        return None;
    }
    let mut dismissed = None;
    let rectangle = place(context, "messages", Align2::LEFT_BOTTOM, [MARGIN, -MARGIN], |ui| {
        ui.set_max_width(2.0 * WIDTH);
        for (index, note) in shown {
            ui.horizontal(|ui| {
                if note.is_error() {
                    if ui.small_button("×").clicked() {
                        dismissed = Some(index);
                    }
                    ui.add(egui::Label::new(RichText::new(note.text).color(ERROR)).wrap());
                } else {
                    ui.add(egui::Label::new(note.text).wrap());
                }
            });
        }
    });
    if let Some(index) = dismissed {
        notes.dismiss(index);
        context.request_repaint();
    }
    Some(rectangle)
}

/// A number with its thousands apart.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_apart() {
        for (number, text) in [(0, "0"), (999, "999"), (1000, "1,000"), (1_234_567, "1,234,567")] {
            assert_eq!(grouped(number), text);
        }
    }

    /// All of it, without a window.
    #[test]
    fn everything_finds_its_place() {
        let context = Context::default();
        let statistics = FrameStatistics { triangles: 12_345, ..FrameStatistics::default() };
        let screen = Rect::from_min_size(egui::Pos2::ZERO, Vec2::new(1280.0, 800.0));
        let mut settings = Settings { pixels: 0.01, memory: 1, max_triangles: Some(10) };
        let mut notes = Notes::default();
        notes.error("it failed");
        let mut shown = |overlay: Overlay| {
            let mut covered = Vec::new();
            // The first time, sizes are not yet known.
            for _ in 0..3 {
                let input = egui::RawInput { screen_rect: Some(screen), ..egui::RawInput::default() };
                let output = context.run_pass(input, |context| {
                    let figures = Figures {
                        frame_ms: 1.0,
                        frame_rate: Some(60.0),
                        statistics: &statistics,
                        totals: Totals::default(),
                        upload: Upload::default(),
                        budget_bytes: 1 << 24,
                        resident_bytes: None,
                        gpu_bytes: [1 << 20, 1 << 29],
                        is_settled: true,
                        is_frozen: false,
                        recorded: Some(3),
                        style: Style { edges: true, ..Style::default() },
                        renderer: "a card",
                        corner: Some([800, 500, 400, 250]),
                    };
                    let ranges = Ranges { least_memory: 1 << 20, most_memory: 1 << 33, triangles: 1 << 20 };
                    let scenery = Scenery::Model { figures, settings: &mut settings, ranges };
                    covered = overlay.show(context, scenery, &mut notes);
                });
                output.drop_without_applying_deltas();
            }
            covered
        };
        let all = shown(Overlay { help: true, is_hidden: false });
        assert_eq!(all.len(), 3);
        assert!(all.iter().all(|place| screen.contains_rect(*place) && place.area() > 1000.0), "{all:?}");
        assert!(!all[0].intersects(all[1]) && !all[0].intersects(all[2]) && !all[1].intersects(all[2]), "{all:?}");
        // Hidden, an error is still there.
        assert_eq!(shown(Overlay { help: true, is_hidden: true }).len(), 1);
        // To look at sliders moves none of them.
        assert_eq!(settings, Settings { pixels: 0.01, memory: 1, max_triangles: Some(10) });
    }
}
