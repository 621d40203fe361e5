//! A decoder of model files, slow and obvious, written from `docs/format.md` and from nothing else: what a page is must follow from
//! that document.
//!
//! It shares no code with `metanode`'s and keeps its data otherwise: the whole file is in memory, nodes are in a map by born leaf,
//! which is made anew from the ancestors for every page, bits are taken one by one, and a symbol's interval is found by going
//! through all. What the document calls "the page at hand" is `nodes` here, with those of its ancestors; each field is a function,
//! in the order of the document's section 9. It believes the file: one that is wrong makes it panic.

use std::collections::BTreeMap;

/// A decoded page.
#[derive(Debug, Clone, PartialEq)]
pub struct Page {
    /// Its number.
    pub number: u32,
    /// Its parent's.
    pub parent: Option<u32>,
    /// Number, byte offset and length of each child page.
    pub children: Vec<(u32, u64, u32)>,
    /// How many of the records are roots of the page.
    pub root_count: usize,
    /// The first leaf, and one past the last.
    pub leaves: (u32, u32),
    /// Its splits.
    pub records: Vec<Record>,
}

/// A split.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The leaf that is born.
    pub born_leaf: u32,
    /// Where it is.
    pub position: [f32; 3],
    /// Its normal's word.
    pub normal: u32,
    /// The kept and the born child, where they split further.
    pub children: [Option<Entry>; 2],
    /// The triangles that are born, sorted.
    pub triangles: Vec<[u32; 3]>,
    /// The wedges of the born leaf; none without attributes.
    pub wedges: Vec<Wedge>,
    /// For each triangle the numbers of its corners' wedges; none without seams.
    pub corner_wedges: Vec<[u32; 3]>,
}

/// The attributes of some corners at a leaf, and where they are in the forest of wedges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wedge {
    /// Its number.
    pub number: u32,
    /// One past the numbers of what turns into it.
    pub end: u32,
    /// Its material, counted from 1; 0 for none.
    pub material: u32,
    /// Its texture coordinate, in steps.
    pub texture: [i32; 2],
    /// Red, green, blue, alpha.
    pub colour: [u8; 4],
    /// The word of the normal that the file gave.
    pub normal: u32,
}

/// What wedges refer to, and those that no split bears.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance {
    /// Whether there are normals, colours, texture coordinates, materials.
    pub kinds: [bool; 4],
    /// Whether there are leaves with several wedges.
    pub has_seams: bool,
    /// Texture coordinates are in steps of 2 to this.
    pub texture_exponent: i32,
    /// The logarithm of how long ways in the texture are for those in the mesh.
    pub texture_density: i32,
    /// All wedges.
    pub wedge_count: u32,
    /// The wedges of the first leaf of each tree.
    pub root_wedges: Vec<Vec<Wedge>>,
    /// The materials.
    pub materials: Vec<Material>,
    /// The names of the images, and their bytes; none for a missing one.
    pub images: Vec<(String, Option<Vec<u8>>)>,
}

/// A material.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Its name.
    pub name: String,
    /// Red, green, blue, alpha.
    pub base_colour: Option<[f32; 4]>,
    /// Its image, counted from 1; 0 for none.
    pub image: u32,
}

/// A child that splits further.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Its dependency id.
    pub id: u32,
    /// Its switch value.
    pub switch: f32,
    /// The radius of its bounding sphere.
    pub radius: f32,
    /// Its cone: axis, and the sine of the half-angle.
    pub cone: ([i8; 3], u8),
    /// The child page that its split is in, counted from 0; none for this page.
    pub child_page: Option<usize>,
    /// The record there.
    pub record: usize,
}

/// Decodes a whole model file: its appearance, if it has one, and its pages by number, each from its ancestors alone.
pub fn decode(file: &[u8]) -> (Option<Appearance>, BTreeMap<u32, Page>) {
    let model = Model::read(file);
    let mut pages = BTreeMap::new();
    for &(number, offset, length) in &model.root_pages {
        model.decode_below(&[], (number, offset, length), &mut pages);
    }
    (model.appearance, pages)
}

type Vector = [f32; 3];

// Section 2: arithmetic.

fn dot(a: Vector, b: Vector) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn each(a: Vector, b: Vector, combine: impl Fn(f32, f32) -> f32) -> Vector {
    [combine(a[0], b[0]), combine(a[1], b[1]), combine(a[2], b[2])]
}

fn minus(a: Vector, b: Vector) -> Vector {
    each(a, b, |a, b| a - b)
}

fn log(value: f32) -> i32 {
    (value.abs().to_bits() >> 19) as i32 - 2032
}

fn half(value: f32) -> i32 {
    (value.abs().to_bits() >> 22) as i32
}

fn nearest(value: f32) -> i32 {
    if value.is_sign_negative() { (value - 0.5) as i32 } else { (value + 0.5) as i32 }
}

/// Between the two, at least and at most.
fn within(value: i32, least: i32, most: i32) -> i32 {
    value.max(least).min(most)
}

// Section 1: normals and switch values.

fn signed_like(value: i32, sign: i32) -> i32 {
    if sign < 0 { -value } else { value }
}

fn decoded_normal(word: u32) -> Vector {
    let (x, y) = ((word % 1024) as i32 - 511, (word / 1024 % 1024) as i32 - 511);
    let z = 511 - x.abs() - y.abs();
    let (x, y) = if z < 0 { (signed_like(511 - y.abs(), x), signed_like(511 - x.abs(), y)) } else { (x, y) };
    let [x, y, z] = [x as f32, y as f32, z as f32];
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

fn encoded_normal(direction: Vector) -> (i32, i32) {
    let [x, y, z] = direction.map(f64::from);
    let sum = x.abs() + y.abs() + z.abs();
    if !sum.is_finite() || sum == 0.0 {
        return (511, 511);
    }
    let (x, y) = (x / sum, y / sum);
    let turned = |value: f64, sign: f64| if sign < 0.0 { -value } else { value };
    let (u, v) = if z < 0.0 { (turned(1.0 - y.abs(), x), turned(1.0 - x.abs(), y)) } else { (x, y) };
    ((u * 511.0 + 511.5) as i32, (v * 511.0 + 511.5) as i32)
}

fn switch_value(id: u32, exponent: i32) -> f32 {
    let class = id >> 16;
    let steps = [0, 0x0b_95c2, 0x18_37f1, 0x25_fed7, 0x35_04f4, 0x45_672b, 0x57_44fd, 0x6a_c0c7_u32];
    let mantissa = f32::from_bits(0x3f80_0000 + steps[((class - 1) % 8) as usize]);
    let octave = within(exponent - 33 + ((class - 1) / 8) as i32, -512, 512);
    let value = (f64::from(mantissa) * 2.0_f64.powi(octave)) as f32;
    value.clamp(f32::MIN_POSITIVE, f32::MAX)
}

// Sections 3 and 4: the file.

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take(&mut self, count: usize) -> u64 {
        let (number, rest) = self.0.split_at(count);
        self.0 = rest;
        number.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte))
    }

    fn word(&mut self) -> u32 {
        self.take(4) as u32
    }

    fn float(&mut self) -> f32 {
        f32::from_bits(self.word())
    }

    fn text(&mut self) -> String {
        let length = self.word();
        String::from_utf8((0..length).map(|_| self.take(1) as u8).collect()).unwrap()
    }
}

/// A tree, by the root table.
struct Tree {
    start: u32,
    end: u32,
    position: Vector,
    id: u32,
    radius: f32,
    record: usize,
    page: u32,
    normal: u32,
    is_inward: bool,
}

struct Model<'a> {
    file: &'a [u8],
    exponent: i32,
    step: f32,
    trees: Vec<Tree>,
    root_pages: Vec<(u32, u64, u32)>,
    appearance: Option<Appearance>,
    frequent: Vec<u32>,
    /// 0 where there is none.
    denominator: f32,
    /// For each family, context and symbol, its parts of 4096.
    symbols: BTreeMap<(Family, usize), Vec<u32>>,
    /// For each family and context, the parts of "yes".
    decisions: BTreeMap<(Choice, usize), u32>,
}

/// The families of symbols, in the order of section 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Family {
    Structure,
    SubtreeSize,
    SubtreeRadius,
    ClassStep,
    Chain,
    FirstCoordinate,
    SecondCoordinate,
    ThirdCoordinate,
    FirstFrequent,
    SecondFrequent,
    ThirdFrequent,
    Fraction,
    TriangleCount,
    FirstNormal,
    SecondNormal,
    Cone,
    Outside,
    WedgeCount,
    WedgeImage,
    Material,
    MaterialNumber,
    FirstTexture,
    SecondTexture,
    Colour,
    FirstWedgeNormal,
    SecondWedgeNormal,
    SubtreeWedges,
    CornerWedge,
}

/// The families of decisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Choice {
    Down,
    Up,
    FirstLeaf,
    Sign,
}

/// Contexts and symbols of each.
const FAMILIES: [(Family, usize, usize); 28] = [
    (Family::Structure, 20, 9),
    (Family::SubtreeSize, 1, 64),
    (Family::SubtreeRadius, 16, 64),
    (Family::ClassStep, 20, 64),
    (Family::Chain, 24, 64),
    (Family::FirstCoordinate, 9, 44),
    (Family::SecondCoordinate, 36, 44),
    (Family::ThirdCoordinate, 9, 44),
    (Family::FirstFrequent, 24, 64),
    (Family::SecondFrequent, 48, 64),
    (Family::ThirdFrequent, 72, 64),
    (Family::Fraction, 6, 8),
    (Family::TriangleCount, 2, 5),
    (Family::FirstNormal, 8, 40),
    (Family::SecondNormal, 24, 40),
    (Family::Cone, 18, 17),
    (Family::Outside, 8, 128),
    (Family::WedgeCount, 4, 16),
    (Family::WedgeImage, 16, 16),
    (Family::Material, 2, 2),
    (Family::MaterialNumber, 1, 64),
    (Family::FirstTexture, 9, 44),
    (Family::SecondTexture, 36, 44),
    (Family::Colour, 12, 40),
    (Family::FirstWedgeNormal, 6, 40),
    (Family::SecondWedgeNormal, 6, 40),
    (Family::SubtreeWedges, 2, 64),
    (Family::CornerWedge, 48, 16),
];
/// Contexts of each.
const CHOICES: [(Choice, usize); 4] =
    [(Choice::Down, 1872), (Choice::Up, 2016), (Choice::FirstLeaf, 3), (Choice::Sign, 2)];

/// A stream of bits, lowest first.
struct BitStream<'a> {
    bytes: &'a [u8],
    next: usize,
}

impl BitStream<'_> {
    fn take(&mut self, count: u32) -> u64 {
        let mut number = 0;
        for bit in 0..count {
            number |= u64::from(self.bytes[self.next / 8] >> (self.next % 8) & 1) << bit;
            self.next += 1;
        }
        number
    }

    /// All bytes were used, and what is left of the last one is 0.
    fn check_end(mut self) {
        assert_eq!(self.next.div_ceil(8), self.bytes.len(), "bytes that nobody wants");
        assert_eq!(self.take((self.bytes.len() * 8 - self.next) as u32), 0, "bits that nobody wants");
    }
}

fn value_of_class(class: u32) -> u32 {
    if class < 8 {
        return class;
    }
    let leading = class / 4 + 1;
    ((4 + class % 4) << (leading - 2)) + (1 << (leading - 3))
}

fn parts_of_symbols(weights: &[u32]) -> Vec<u32> {
    let count = weights.len() as u32;
    let weights = if weights.iter().all(|weight| *weight == 0) { vec![1; weights.len()] } else { weights.to_vec() };
    let sum: u32 = weights.iter().sum();
    let mut parts: Vec<u32> = weights.iter().map(|weight| 1 + weight * (4096 - count) / sum).collect();
    let largest = weights.iter().max().unwrap();
    let first_largest = weights.iter().position(|weight| weight == largest).unwrap();
    parts[first_largest] += 4096 - parts.iter().sum::<u32>();
    parts
}

impl<'a> Model<'a> {
    fn read(file: &'a [u8]) -> Self {
        let at = |offset: usize| Bytes(&file[offset..]);
        assert_eq!((&file[..8], at(8).word(), at(16).word()), (&b"VDTMODEL"[..], 3, 256));
        assert_eq!((at(132).take(8), at(148).take(8)), (256, file.len() as u64));
        let (tree_count, root_page_count, way_count) = (at(32).word(), at(40).word(), at(172).word());
        let mut tables = at(256);
        let trees: Vec<Tree> = (0..tree_count).map(|_| read_tree(&mut tables)).collect();
        let mut root_pages = Vec::new();
        for _ in 0..root_page_count {
            root_pages.push((tables.word(), tables.take(8), tables.word()));
        }
        let after_roots = 256 + 60 * tree_count as usize + 16 * root_page_count as usize + 20 * way_count as usize;
        let coder_start = after_roots + 4;
        let coder_end = coder_start + at(176).word() as usize;
        let (appearance_start, appearance_length) = (coder_end + 4, at(180).word() as usize);
        let images_start = appearance_start + appearance_length;
        let images_end = images_start + at(184).take(8) as usize;
        assert_eq!(at(140).take(8), images_end as u64);
        let appearance = match at(12).word() {
            0 => {
                assert_eq!(images_end, appearance_start);
                None
            }
            flags => {
                assert_eq!(flags, 1);
                let bytes = &file[appearance_start..images_start - 4];
                Some(read_appearance(bytes, &file[images_start..images_end], &trees))
            }
        };
        let mut model = Model {
            file,
            exponent: at(160).word().cast_signed(),
            step: at(168).float(),
            trees,
            root_pages,
            appearance,
            frequent: Vec::new(),
            denominator: 0.0,
            symbols: BTreeMap::new(),
            decisions: BTreeMap::new(),
        };
        model.read_coder_tables(&file[coder_start..coder_end]);
        model
    }

    fn read_coder_tables(&mut self, bytes: &[u8]) {
        let mut bits = BitStream { bytes, next: 0 };
        for _ in 0..bits.take(6) {
            self.frequent.push(bits.take(32) as u32);
        }
        if bits.take(1) == 1 {
            self.denominator = f32::from_bits(bits.take(32) as u32);
        }
        let own = ContextTables::read(&mut bits, &FAMILIES, &CHOICES);
        bits.check_end();
        let (counts, built_in) = BUILT_IN.split_at(2);
        let mut bits = BitStream { bytes: built_in, next: 0 };
        let built_in = ContextTables::read(&mut bits, &FAMILIES[..counts[0].into()], &CHOICES[..counts[1].into()]);
        bits.check_end();
        for (family, contexts, symbols) in FAMILIES {
            for context in 0..contexts {
                let key = (family, context);
                let weights = own.symbols.get(&key).or(built_in.symbols.get(&key)).cloned();
                self.symbols.insert(key, parts_of_symbols(&weights.unwrap_or(vec![0; symbols])));
            }
        }
        for (choice, contexts) in CHOICES {
            for context in 0..contexts {
                let key = (choice, context);
                let yes = own.decisions.get(&key).or(built_in.decisions.get(&key));
                self.decisions.insert(key, yes.copied().unwrap_or(2048));
            }
        }
    }
}

/// The built-in tables.
const BUILT_IN: &[u8] = include_bytes!("../../metanode/src/codec/built_in.tables");

/// The contexts that are written down in tables.
#[derive(Default)]
struct ContextTables {
    /// The weights of the symbols.
    symbols: BTreeMap<(Family, usize), Vec<u32>>,
    /// The parts of "yes".
    decisions: BTreeMap<(Choice, usize), u32>,
}

impl ContextTables {
    fn read(bits: &mut BitStream<'_>, families: &[(Family, usize, usize)], choices: &[(Choice, usize)]) -> Self {
        let mut tables = ContextTables::default();
        for &(family, contexts, symbols) in families {
            let is_some = bits.take(1) == 1;
            for context in 0..contexts {
                if is_some && bits.take(1) == 1 {
                    let mut weights = vec![0; symbols];
                    for weight in &mut weights {
                        if bits.take(1) == 1 {
                            *weight = value_of_class(bits.take(6) as u32);
                        }
                    }
                    tables.symbols.insert((family, context), weights);
                }
            }
        }
        for &(choice, contexts) in choices {
            let is_some = bits.take(1) == 1;
            for context in 0..contexts {
                if is_some && bits.take(1) == 1 {
                    let rarer = value_of_class(bits.take(6) as u32).clamp(1, 4095);
                    let yes = if bits.take(1) == 1 { 4096 - rarer } else { rarer };
                    tables.decisions.insert((choice, context), yes);
                }
            }
        }
        tables
    }
}

fn read_tree(words: &mut Bytes<'_>) -> Tree {
    let (start, end) = (words.word(), words.word());
    let position = [words.float(), words.float(), words.float()];
    let (id, _switch, radius, _cone) = (words.word(), words.float(), words.float(), words.word());
    let (record, page, _offset, _length) = (words.word() as usize, words.word(), words.take(8), words.word());
    let normal = words.word();
    Tree { start, end, position, id, radius, record, page, normal: normal % (1 << 20), is_inward: normal >> 31 == 1 }
}

/// Section 4.1.
fn read_appearance(bytes: &[u8], images: &[u8], trees: &[Tree]) -> Appearance {
    let mut words = Bytes(bytes);
    let bits = words.word();
    let is = |bit: u32| bits >> bit & 1 == 1;
    let (texture_exponent, texture_density) = (words.word().cast_signed(), words.word().cast_signed());
    let (wedge_count, material_count, image_count) = (words.word(), words.word(), words.word());
    let mut appearance = Appearance {
        kinds: [is(0), is(1), is(2), is(3)],
        has_seams: is(4),
        texture_exponent,
        texture_density,
        wedge_count,
        root_wedges: Vec::new(),
        materials: Vec::new(),
        images: Vec::new(),
    };
    for tree in trees {
        let count = if appearance.has_seams { words.word() } else { 1 };
        let wedges = (0..count).map(|_| appearance.wedge(&mut words, tree)).collect();
        appearance.root_wedges.push(wedges);
    }
    for _ in 0..material_count {
        let (name, has_colour) = (words.text(), words.word() == 1);
        let colour = [words.float(), words.float(), words.float(), words.float()];
        let base_colour = if has_colour { Some(colour) } else { None };
        appearance.materials.push(Material { name, base_colour, image: words.word() });
    }
    let mut images = images;
    for _ in 0..image_count {
        let (name, length, _checksum) = (words.text(), words.take(8), words.word());
        let mut image = None;
        if length < u64::MAX {
            let (own, others) = images.split_at(length as usize);
            (image, images) = (Some(own.to_vec()), others);
        }
        appearance.images.push((name, image));
    }
    assert!(words.0.is_empty() && images.is_empty());
    appearance
}

/// What a wedge has of which the model says nothing.
const PLAIN: Wedge =
    Wedge { number: 0, end: 0, material: 0, texture: [0; 2], colour: [255; 4], normal: 511 + 1024 * 511 };

impl Appearance {
    /// Section 5.5: a wedge of the first leaf of a tree.
    fn wedge(&self, words: &mut Bytes<'_>, tree: &Tree) -> Wedge {
        let [normals, colours, textures, materials] = self.kinds;
        let mut wedge = Wedge { number: tree.start, end: tree.start + 1, ..PLAIN };
        if self.has_seams {
            (wedge.number, wedge.end) = (words.word(), words.word());
        }
        if normals {
            wedge.normal = if self.has_seams { words.word() } else { tree.normal };
        }
        if colours {
            wedge.colour = [(); 4].map(|()| words.take(1) as u8);
        }
        if textures {
            wedge.texture = [(); 2].map(|()| words.word().cast_signed());
        }
        if materials {
            wedge.material = words.word();
        }
        wedge
    }
}

// Section 7.3: the coded fields.

struct Coded<'a> {
    model: &'a Model<'a>,
    states: [u32; 2],
    /// Symbols so far.
    count: usize,
    words: Bytes<'a>,
    raw: BitStream<'a>,
}

impl<'a> Coded<'a> {
    fn new(model: &'a Model<'a>, bytes: &'a [u8]) -> Self {
        let mut start = Bytes(bytes);
        let words = start.word() as usize;
        let states = [start.word(), start.word()];
        let (words, raw) = start.0.split_at(2 * words);
        Coded { model, states, count: 0, words: Bytes(words), raw: BitStream { bytes: raw, next: 0 } }
    }

    /// Which of the intervals with these parts it is.
    fn interval(&mut self, parts: &[u32]) -> usize {
        let state = &mut self.states[self.count % 2];
        self.count += 1;
        let value = *state % 4096;
        let (mut symbol, mut start) = (0, 0);
        while value >= start + parts[symbol] {
            start += parts[symbol];
            symbol += 1;
        }
        *state = parts[symbol] * (*state / 4096) + value - start;
        if *state < 65536 {
            *state = 65536 * *state + self.words.take(2) as u32;
        }
        symbol
    }

    fn symbol(&mut self, family: Family, context: usize) -> usize {
        let model = self.model;
        self.interval(&model.symbols[&(family, context)])
    }

    fn decision(&mut self, choice: Choice, context: usize) -> bool {
        let yes = self.model.decisions[&(choice, context)];
        self.interval(&[yes, 4096 - yes]) == 0
    }

    fn raw(&mut self, count: u32) -> u64 {
        self.raw.take(count)
    }

    fn check_end(self) {
        assert_eq!(self.states, [65536; 2]);
        assert!(self.words.0.is_empty());
        self.raw.check_end();
    }

    /// The magnitude of a half-octave class (section 7.4).
    fn magnitude(&mut self, class: i32) -> i64 {
        if class < 4 {
            return class.into();
        }
        let bits = (class / 2 - 1) as u32;
        let smallest = i64::from(2 + class % 2) << bits;
        // The lowest bits come first, however many are taken at a time.
        smallest + self.raw(bits) as i64
    }

    /// A number whose size is roughly known (section 7.4).
    fn number(&mut self, family: Family, first: usize, expected: i32) -> i64 {
        let b = within(expected >> 4, 0, 80);
        let (context, base) = if b < 8 { (b as usize, 0) } else { (8, b - 14) };
        let symbol = self.symbol(family, first + context);
        let place = (symbol / 2) as i32 - 1;
        let class = if place == -1 || place == 20 { self.raw(7) as i32 } else { base + place };
        let magnitude = self.magnitude(within(class, 0, 81));
        if symbol % 2 == 1 { -magnitude } else { magnitude }
    }

    /// A small number (section 9.2).
    fn small(&mut self, family: Family, context: usize) -> u32 {
        match self.symbol(family, context) {
            63 => self.raw(16) as u32,
            symbol => symbol as u32,
        }
    }

    /// A number as its class (section 9.9).
    fn amount(&mut self, family: Family, context: usize) -> u32 {
        let class = self.symbol(family, context);
        self.magnitude(class as i32) as u32
    }

    /// A place (section 9.9).
    fn place(&mut self, family: Family, context: usize) -> usize {
        match self.symbol(family, context) {
            15 => self.raw(10) as usize,
            symbol => symbol,
        }
    }

    /// A difference, by another one (section 9.9).
    fn near(&mut self, family: Family, i: usize, before: i64) -> i64 {
        let level = match before.abs() {
            0 => 0,
            1..=8 => 1,
            _ => 2,
        };
        self.difference(family, 3 * i + level)
    }

    /// A difference as its class and sign in one symbol, in sections 9.6, 9.7 and 9.9.
    fn difference(&mut self, family: Family, context: usize) -> i64 {
        let symbol = self.symbol(family, context);
        let magnitude = self.magnitude((symbol / 2) as i32);
        if symbol % 2 == 1 { -magnitude } else { magnitude }
    }
}

// Section 8: what a decoder knows of nodes.

const KEPT: usize = 0;
const BORN: usize = 1;

/// A child of a node.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Child {
    Leaf,
    /// It splits in a page that is at hand, or is an ancestor; its node, by born leaf.
    Node(u32),
    Elsewhere,
}

/// A node that splits. Nodes are named by the leaf that they bear.
#[derive(Debug, Clone)]
struct Node {
    start: u32,
    end: u32,
    born: u32,
    /// The node above, and which of its children this is.
    parent: Option<(u32, usize)>,
    children: [Child; 2],
    id: u32,
    radius: f32,
    places: [Vector; 2],
    steps: [[i64; 3]; 2],
    normals: [Vector; 2],
    length: i32,
    bend: i32,
    radii: [f32; 2],
    is_inward: bool,
}

impl Node {
    fn size(&self) -> u32 {
        self.end - self.start
    }

    fn leaves(&self, side: usize) -> (u32, u32) {
        if side == KEPT { (self.start, self.born) } else { (self.born, self.end) }
    }

    fn displacement(&self) -> Vector {
        minus(self.places[BORN], self.places[KEPT])
    }

    /// What follows for a child of it, whose split is yet to come.
    fn child(&self, side: usize) -> Node {
        let (start, end) = self.leaves(side);
        let d = self.displacement();
        let off = dot(d, self.normals[KEPT]);
        let run = |before: i32, now: i32| within(before + (now - before) * 3 / 8, -8192, 8192);
        Node {
            start,
            end,
            born: 0,
            parent: Some((self.born, side)),
            children: [Child::Leaf; 2],
            id: 0,
            radius: self.radii[side],
            places: [self.places[side]; 2],
            steps: [self.steps[side]; 2],
            normals: [self.normals[side]; 2],
            length: run(self.length, log(dot(d, d)) - log(self.size() as f32)),
            bend: run(self.bend, within(log(off * off) - log(dot(d, d)), -256, 32)),
            radii: [0.0; 2],
            is_inward: self.is_inward,
        }
    }
}

/// The estimate of a normal at the other end of a displacement.
fn reflected(normal: Vector, d: Vector) -> Vector {
    let square = dot(d, d);
    let factor = 1.2 * dot(normal, d) / square;
    let turned = each(normal, d, |normal, d| normal - factor * d);
    let length = dot(turned, turned).sqrt();
    if square > 0.0 && length > 0.0 { turned.map(|value| value / length) } else { normal }
}

impl Model<'_> {
    fn whole(&self, value: f32) -> i64 {
        let exact = if self.step > 0.0 {
            f64::from(value) / f64::from(self.step)
        } else {
            f64::from(value) * f64::from(self.denominator)
        };
        (exact.round() as i32).into()
    }

    fn root_of(&self, tree: &Tree) -> Node {
        Node {
            start: tree.start,
            end: tree.end,
            born: 0,
            parent: None,
            children: [Child::Leaf; 2],
            id: tree.id,
            radius: tree.radius,
            places: [tree.position; 2],
            steps: [tree.position.map(|value| self.whole(value)); 2],
            normals: [decoded_normal(tree.normal); 2],
            length: within(log(tree.radius * tree.radius) - log((tree.end - tree.start) as f32), -8192, 8192),
            bend: -96,
            radii: [0.0; 2],
            is_inward: tree.is_inward,
        }
    }

    /// The roots of a page, by record, before their splits are known.
    fn roots(&self, number: u32, parent: Option<&Page>, nodes: &BTreeMap<u32, Node>) -> Vec<Node> {
        let mut roots = BTreeMap::new();
        for tree in self.trees.iter().filter(|tree| tree.page == number) {
            roots.insert(tree.record, self.root_of(tree));
        }
        for record in parent.iter().flat_map(|parent| &parent.records) {
            for (side, entry) in record.children.iter().enumerate() {
                let Some(entry) = entry else { continue };
                if entry.child_page.is_some_and(|child| parent.unwrap().children[child].0 == number) {
                    let root = Node { id: entry.id, ..nodes[&record.born_leaf].child(side) };
                    assert!(roots.insert(entry.record, root).is_none());
                }
            }
        }
        assert!(roots.keys().copied().eq(0..roots.len()));
        roots.into_values().collect()
    }

    /// The nodes of the pages from a root page down.
    fn known(&self, ancestors: &[Page]) -> BTreeMap<u32, Node> {
        let mut nodes = BTreeMap::new();
        for (level, page) in ancestors.iter().enumerate() {
            let parent = level.checked_sub(1).map(|above| &ancestors[above]);
            let mut waiting = self.roots(page.number, parent, &nodes);
            for (index, record) in page.records.iter().enumerate() {
                let mut node = waiting[index].clone();
                node.born = record.born_leaf;
                node.places[BORN] = record.position;
                node.steps[BORN] = record.position.map(|value| self.whole(value));
                node.normals[BORN] = decoded_normal(record.normal);
                for (side, entry) in record.children.iter().enumerate() {
                    let Some(entry) = entry else { continue };
                    node.radii[side] = entry.radius;
                    if entry.child_page.is_none() {
                        node.children[side] = Child::Node(page.records[entry.record].born_leaf);
                        waiting.push(Node { id: entry.id, ..node.child(side) });
                        assert_eq!(waiting.len() - 1, entry.record);
                    } else {
                        node.children[side] = Child::Elsewhere;
                    }
                }
                add(&mut nodes, node);
            }
        }
        nodes
    }
}

impl Model<'_> {
    /// The wedges of the first leaves of all trees, and of the leaves that ancestors bear.
    fn known_wedges(&self, ancestors: &[Page]) -> BTreeMap<u32, Vec<Wedge>> {
        let mut wedges = BTreeMap::new();
        if let Some(appearance) = &self.appearance {
            let of_trees = self.trees.iter().zip(&appearance.root_wedges);
            wedges.extend(of_trees.map(|(tree, own)| (tree.start, own.clone())));
            let records = ancestors.iter().flat_map(|page| &page.records);
            wedges.extend(records.map(|record| (record.born_leaf, record.wedges.clone())));
        }
        wedges
    }
}

/// Adds a node, to which that above leads.
fn add(nodes: &mut BTreeMap<u32, Node>, node: Node) {
    if let Some((parent, side)) = node.parent {
        nodes.get_mut(&parent).unwrap().children[side] = Child::Node(node.born);
    }
    nodes.insert(node.born, node);
}

// Sections 6 and 9: a page.

/// The page at hand.
struct Decoder<'a> {
    model: &'a Model<'a>,
    coded: Coded<'a>,
    has_children: bool,
    /// All nodes at hand, by born leaf.
    nodes: BTreeMap<u32, Node>,
    /// The born leaves of the page's records.
    records: Vec<u32>,
    root_count: usize,
    /// For each record and side, the class of the cone.
    cones: BTreeMap<(u32, usize), u8>,
    /// For each record, what it bears: whether to the right, and the corners.
    triangles: BTreeMap<u32, Vec<(bool, [Corner; 3])>>,
    normals: BTreeMap<u32, u32>,
    /// The ids of all children that split.
    ids: BTreeMap<(u32, usize), u32>,
    /// The wedges of all leaves that are known.
    wedges: BTreeMap<u32, Vec<Wedge>>,
    /// For each record the places of its wedges' images.
    images: BTreeMap<u32, Vec<usize>>,
    /// For each child in a child page how many wedges turn into each of its own.
    below: BTreeMap<(u32, usize), Vec<u32>>,
    /// For each record and triangle, in the order in which they were coded, the wedges of the corners: kept, born, third.
    corner_wedges: BTreeMap<u32, Vec<[u32; 3]>>,
    outside: [Option<(u32, Vector)>; 16],
    outside_count: usize,
}

/// Where a way has led.
#[derive(Debug, Clone, Copy)]
struct Corner {
    leaf: u32,
    place: Vector,
    is_placed: bool,
}

impl Model<'_> {
    fn decode_below(&self, ancestors: &[Page], at: (u32, u64, u32), pages: &mut BTreeMap<u32, Page>) {
        let page = self.decode_page(ancestors, at);
        let children = page.children.clone();
        let mut chain = ancestors.to_vec();
        chain.push(page.clone());
        assert!(pages.insert(at.0, page).is_none());
        for child in children {
            self.decode_below(&chain, child, pages);
        }
    }

    fn decode_page(&self, ancestors: &[Page], (number, offset, length): (u32, u64, u32)) -> Page {
        let bytes = &self.file[offset as usize..][..length as usize];
        let mut head = Bytes(&bytes[..bytes.len() - 4]);
        assert_eq!(head.word(), number);
        let parent = head.word();
        assert_eq!(parent, ancestors.last().map_or(u32::MAX, |page| page.number));
        assert_eq!(head.word(), length);
        let (record_count, root_count) = (head.take(2) as usize, head.take(2) as usize);
        let (child_count, more_wedges) = (head.take(2) as u32, head.take(2) as usize);
        let triangle_count = head.word() as usize;
        let (mut children, mut entries) = (Vec::new(), Vec::new());
        if child_count > 0 {
            let first = head.word();
            let mut child_offset = head.take(8);
            for child in 0..child_count {
                let child_length = head.word();
                children.push((first + child, child_offset, child_length));
                entries.push(head.take(2) as usize);
                child_offset += u64::from(child_length);
            }
        }
        let nodes = self.known(ancestors);
        let roots = self.roots(number, ancestors.last(), &nodes);
        assert_eq!(roots.len(), root_count);
        let mut decoder = Decoder {
            model: self,
            coded: Coded::new(self, head.0),
            has_children: child_count > 0,
            nodes,
            records: Vec::new(),
            root_count,
            cones: BTreeMap::new(),
            triangles: BTreeMap::new(),
            normals: BTreeMap::new(),
            ids: BTreeMap::new(),
            wedges: self.known_wedges(ancestors),
            images: BTreeMap::new(),
            below: BTreeMap::new(),
            corner_wedges: BTreeMap::new(),
            outside: [None; 16],
            outside_count: 0,
        };
        decoder.structure(roots, record_count);
        decoder.decode_ids();
        decoder.positions();
        decoder.radii();
        decoder.decode_triangles();
        assert_eq!(decoder.triangles.values().map(Vec::len).sum::<usize>(), triangle_count);
        decoder.decode_normals();
        decoder.decode_cones();
        if let Some(appearance) = &self.appearance {
            decoder.decode_wedges(appearance);
        }
        let born = decoder.records.iter().filter_map(|record| decoder.wedges.get(record).map(Vec::len));
        assert_eq!(born.sum::<usize>(), if self.appearance.is_some() { record_count + more_wedges } else { 0 });
        let records = decoder.records(&children, &entries);
        let leaves = (decoder.nodes[&decoder.records[0]].start, decoder.nodes[&decoder.records[root_count - 1]].end);
        decoder.coded.check_end();
        let parent = ancestors.last().map(|page| page.number);
        Page { number, parent, children, root_count, leaves, records }
    }
}

/// A position while its coordinates are decoded, from that of the kept leaf.
struct Found {
    place: Vector,
    steps: [i64; 3],
    /// How many coordinates were frequent numbers, and how many no fractions.
    frequent: usize,
    none: usize,
}

/// What is expected of a coordinate.
struct Guess {
    family: Family,
    first: usize,
    shift: f32,
    expected: i32,
    bend: i32,
}

/// The place of a float in the order of all.
fn order_of(value: f32) -> i64 {
    let bits = i64::from(value.to_bits().cast_signed());
    if bits < 0 { -(1 << 31) - bits } else { bits }
}

fn float_of(order: i64) -> f32 {
    f32::from_bits(if order < 0 { -(1 << 31) - order } else { order } as i32 as u32)
}

/// A record while its leaves are not known.
struct Kind {
    parent: Option<(usize, usize)>,
    root: usize,
    kind: usize,
    /// Sizes of the children; 0 while it is not known.
    sizes: [u32; 2],
    radii: [f32; 2],
    /// The record of each child in this page.
    here: [Option<usize>; 2],
}

impl Decoder<'_> {
    /// Section 9.1.
    fn structure(&mut self, roots: Vec<Node>, record_count: usize) {
        let mut kinds: Vec<Kind> = Vec::new();
        let new = |parent, root| Kind { parent, root, kind: 9, sizes: [0; 2], radii: [0.0; 2], here: [None; 2] };
        kinds.extend((0..roots.len()).map(|root| new(None, root)));
        let mut index = 0;
        while index < kinds.len() {
            let above = kinds[index].parent.map_or(9, |(parent, _)| kinds[parent].kind);
            let kind = self.coded.symbol(Family::Structure, 2 * above + usize::from(self.has_children));
            kinds[index].kind = kind;
            let root = kinds[index].root;
            for (side, of_child) in [kind / 3, kind % 3].into_iter().enumerate() {
                match of_child {
                    0 => kinds[index].sizes[side] = 1,
                    1 => {
                        kinds[index].here[side] = Some(kinds.len());
                        kinds.push(new(Some((index, side)), root));
                    }
                    _ => (kinds[index].sizes[side], kinds[index].radii[side]) = self.subtree(&roots[root]),
                }
            }
            index += 1;
        }
        assert_eq!(kinds.len(), record_count);
        for index in (0..record_count).rev() {
            for side in [KEPT, BORN] {
                if let Some(child) = kinds[index].here[side] {
                    kinds[index].sizes[side] = kinds[child].sizes[KEPT] + kinds[child].sizes[BORN];
                }
            }
        }
        // Starts, from the top down.
        let mut starts: Vec<u32> = Vec::new();
        for (index, kind) in kinds.iter().enumerate() {
            let start = match kind.parent {
                None => {
                    assert_eq!(kind.sizes[KEPT] + kind.sizes[BORN], roots[index].size());
                    roots[index].start
                }
                Some((parent, KEPT)) => starts[parent],
                Some((parent, _)) => starts[parent] + kinds[parent].sizes[KEPT],
            };
            starts.push(start);
        }
        self.records = starts.iter().zip(&kinds).map(|(start, kind)| start + kind.sizes[KEPT]).collect();
        for (index, kind) in kinds.iter().enumerate() {
            // What is above is not placed yet, so only the leaves of what follows from it are of use.
            let mut node = match kind.parent {
                None => roots[index].clone(),
                Some((parent, side)) => self.nodes[&self.records[parent]].child(side),
            };
            node.born = self.records[index];
            node.radii = kind.radii;
            let kinds = [kind.kind / 3, kind.kind % 3];
            for side in [KEPT, BORN] {
                node.children[side] = if kinds[side] == 2 { Child::Elsewhere } else { Child::Leaf };
            }
            add(&mut self.nodes, node);
        }
    }

    /// Size and radius of a subtree in a child page, below a root of this one.
    fn subtree(&mut self, root: &Node) -> (u32, f32) {
        let symbol = self.coded.symbol(Family::SubtreeSize, 0) as u32;
        let (top, second) = (symbol / 2, symbol % 2);
        let size = ((2 + second) << (top - 1)) + self.coded.raw(top - 1) as u32;
        let context = (log(root.size() as f32) - log(size as f32)) / 16;
        let smaller = self.coded.symbol(Family::SubtreeRadius, context.min(15) as usize);
        if smaller == 63 {
            return (size, 0.0);
        }
        let octaves = smaller.div_ceil(4);
        let quarter = [1.0, 1.189_207_2, 1.414_213_7, 1.681_793_f32][4 * octaves - smaller];
        (size, root.radius * (2.0_f32.powi(-(octaves as i32)) * quarter))
    }

    /// The records, each with each side on which a child splits.
    fn splitting_children(&self) -> Vec<(u32, usize)> {
        let sides = self.records.iter().flat_map(|record| [(*record, KEPT), (*record, BORN)]);
        sides.filter(|(record, side)| self.nodes[record].children[*side] != Child::Leaf).collect()
    }

    /// Section 9.2.
    fn decode_ids(&mut self) {
        for (record, side) in self.splitting_children() {
            let node = &self.nodes[&record];
            let (class, chain) = (node.id >> 16, node.id % 65536);
            let (start, end) = node.leaves(side);
            let octave = (end - start).ilog2().min(9) as usize;
            let step = self.coded.small(Family::ClassStep, 2 * octave + side);
            let own_chain = self.coded.small(Family::Chain, (6 * step.min(3) + chain.min(5)) as usize);
            let id = (class - step) << 16 | own_chain;
            assert!(id < node.id && id >> 16 > 0);
            self.ids.insert((record, side), id);
            if let Child::Node(child) = self.nodes[&record].children[side] {
                self.nodes.get_mut(&child).unwrap().id = id;
            }
        }
    }

    /// Section 9.3.
    fn positions(&mut self) {
        for record in self.records.clone() {
            let node = self.nodes[&record].clone();
            let (place, steps) = self.place(&node);
            let node = self.nodes.get_mut(&record).unwrap();
            node.places[BORN] = place;
            node.steps[BORN] = steps;
            node.normals[BORN] = reflected(node.normals[KEPT], node.displacement());
            self.tell_children(record);
        }
    }

    /// Has the nodes below in this page know what follows from their parent.
    fn tell_children(&mut self, record: u32) {
        for side in [KEPT, BORN] {
            if let Child::Node(child) = self.nodes[&record].children[side] {
                let follows = self.nodes[&record].child(side);
                let old = self.nodes[&child].clone();
                let Node { born, children, id, radii, .. } = old;
                self.nodes.insert(child, Node { born, children, id, radii, ..follows });
            }
        }
    }

    fn place(&mut self, node: &Node) -> (Vector, [i64; 3]) {
        let (kept, normal) = (node.places[KEPT], node.normals[KEPT]);
        let [a, b, c] = axes(normal);
        let expected = node.length + log(node.size() as f32);
        let mut found = Found { place: kept, steps: node.steps[KEPT], frequent: 0, none: 0 };
        let expected_a = expected + steep(normal[a]);
        let guess = Guess { family: Family::FirstCoordinate, first: 0, shift: 0.0, expected: expected_a, bend: 0 };
        self.coordinate(&mut found, 0, a, &guess);
        let x = found.place[a] - kept[a];
        let (first, expected_b) = (9 * level(x, expected_a), expected + steep(normal[b]));
        let guess = Guess { family: Family::SecondCoordinate, first, shift: 0.0, expected: expected_b, bend: 0 };
        self.coordinate(&mut found, 1, b, &guess);
        let y = found.place[b] - kept[b];
        let shift = -(normal[a] * x + normal[b] * y) / normal[c];
        let (family, expected) = (Family::ThirdCoordinate, log(x * x + y * y));
        let guess = Guess { family, first: 0, shift, expected, bend: node.bend };
        self.coordinate(&mut found, 2, c, &guess);
        (found.place, found.steps)
    }

    /// Any coordinate, the `turn`th of its record, along an axis.
    fn coordinate(&mut self, found: &mut Found, turn: usize, axis: usize, guess: &Guess) {
        if self.model.step > 0.0 {
            let step = self.model.step;
            self.whole_coordinate(found, turn, axis, guess, step, 1.0 / step);
            found.place[axis] = found.steps[axis] as f32 * step;
            return;
        }
        let denominator = self.model.denominator;
        if denominator > 0.0 {
            let symbol = self.coded.symbol(Family::Fraction, turn * (turn + 1) / 2 + found.none);
            if symbol > 0 {
                self.whole_coordinate(found, turn, axis, guess, 1.0 / denominator, denominator);
                let fraction = found.steps[axis] as f32 / denominator;
                found.place[axis] = float_of(order_of(fraction) + symbol as i64 - 4);
                return;
            }
            found.none += 1;
        }
        found.place[axis] = self.any_float(guess, found.place[axis]);
        found.steps[axis] = self.model.whole(found.place[axis]);
    }

    fn any_float(&mut self, guess: &Guess, kept: f32) -> f32 {
        let near = if (kept + guess.shift).is_finite() { kept + guess.shift } else { kept };
        let grain = f32::from_bits(near.to_bits() & 0x7f80_0000) / 8_388_608.0;
        let expected = guess.expected + guess.bend - log((grain * grain).max(f32::MIN_POSITIVE));
        let found = float_of(order_of(near) + self.coded.number(guess.family, guess.first, expected));
        assert!(found.is_finite());
        found
    }

    fn whole_coordinate(&mut self, found: &mut Found, turn: usize, axis: usize, guess: &Guess, step: f32, units: f32) {
        let q = i64::from(within(nearest(guess.shift * units), -(1 << 30), 1 << 30));
        let mut expected = guess.expected - log(step * step);
        if turn == 2 {
            expected = expected.max(-96);
        }
        expected += guess.bend;
        let about = if turn == 2 { log((q * q) as f32).max(expected) } else { expected };
        found.steps[axis] += match self.frequent(found.frequent, turn, about, q < 0) {
            Some(number) => {
                found.frequent += 1;
                number
            }
            None => q + self.coded.number(guess.family, guess.first, expected),
        };
        assert!(found.steps[axis].abs() <= 1 << 24);
    }

    /// A coordinate, where it is a frequent number.
    fn frequent(&mut self, before: usize, turn: usize, expected: i32, is_guessed_negative: bool) -> Option<i64> {
        if self.model.frequent.is_empty() {
            return None;
        }
        let family = [Family::FirstFrequent, Family::SecondFrequent, Family::ThirdFrequent][turn];
        let symbol = self.coded.symbol(family, 24 * before + within(expected >> 5, 0, 23) as usize);
        if symbol == 0 {
            return None;
        }
        let magnitude = i64::from(self.model.frequent[symbol - 1]);
        if magnitude == 0 {
            return Some(0);
        }
        let is_negative = match turn {
            2 => self.coded.decision(Choice::Sign, usize::from(is_guessed_negative)),
            _ => self.coded.raw(1) == 1,
        };
        Some(if is_negative { -magnitude } else { magnitude })
    }

    /// Section 9.4.
    fn radii(&mut self) {
        const UP: f32 = 1.0 + 1.0 / 2_097_152.0;
        let length = |node: &Node| {
            let d: Vec<f64> =
                (0..3).map(|axis| f64::from(node.places[BORN][axis]) - f64::from(node.places[KEPT][axis])).collect();
            ((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2]).sqrt() as f32 * UP
        };
        for index in (0..self.records.len()).rev() {
            let mut node = self.nodes[&self.records[index]].clone();
            for side in [KEPT, BORN] {
                match node.children[side] {
                    Child::Leaf => node.radii[side] = 0.0,
                    Child::Node(child) => node.radii[side] = self.nodes[&child].radius,
                    Child::Elsewhere => (),
                }
            }
            if index >= self.root_count {
                node.radius = node.radii[KEPT].max((length(&node) + node.radii[BORN]) * UP);
            }
            self.nodes.insert(node.born, node);
        }
        for record in &self.records {
            let mut node = self.nodes[record].clone();
            let left = (node.radius - length(&node)).max(0.0) + node.radius * (1.0 / 2_097_152.0);
            node.radii = [node.radii[KEPT].min(node.radius), node.radii[BORN].min(left)];
            for side in [KEPT, BORN] {
                if let Child::Node(child) = node.children[side] {
                    self.nodes.get_mut(&child).unwrap().radius = node.radii[side];
                }
            }
            self.nodes.insert(*record, node);
        }
    }

    /// Section 9.5.
    fn decode_triangles(&mut self) {
        for index in 0..self.root_count {
            let root = self.records[index];
            self.triangles_below(root);
        }
    }

    fn triangles_below(&mut self, record: u32) {
        let context = usize::from(self.has_children);
        let (left, right) = match self.coded.symbol(Family::TriangleCount, context) {
            0 => (1, 1),
            1 => (1, 0),
            2 => (0, 1),
            3 => (0, 0),
            _ => (self.coded.raw(26), self.coded.raw(26)),
        };
        let mut first_ways = None;
        let mut triangles = Vec::new();
        for number in 0..left + right {
            let is_right = number >= left;
            let mut ways = [Way::new(), Way::new(), Way::new()];
            if let Some(first) = &first_ways {
                ways.iter_mut()
                    .zip(first)
                    .for_each(|(way, first): (&mut Way, &Vec<bool>)| way.first = Some(first.clone()));
            }
            triangles.push((is_right, self.triangle(record, is_right, &mut ways)));
            if first_ways.is_none() {
                first_ways = Some(ways.map(|way| way.taken));
            }
        }
        self.triangles.insert(record, triangles);
        for side in [KEPT, BORN] {
            if let Child::Node(child) = self.nodes[&record].children[side] {
                self.triangles_below(child);
            }
        }
    }

    fn triangle(&mut self, record: u32, is_right: bool, ways: &mut [Way; 3]) -> [Corner; 3] {
        let node = self.nodes[&record].clone();
        let near = |a: Vector, b: Vector, part: f32| {
            let part = if is_right { -part } else { part };
            let aside = cross(node.normals[KEPT], minus(b, a)).map(|value| part * value);
            each(each(a, b, |a, b| 0.5 * (a + b)), aside, |middle, aside| middle + aside)
        };
        let target = near(node.places[KEPT], node.places[BORN], 0.5);
        let square = dot(node.displacement(), node.displacement());
        let (mut to_kept, mut to_born) = ((record, KEPT), (record, BORN));
        loop {
            let is_longer = [
                self.step_down(&mut to_kept, target, 0, &mut ways[0]),
                self.step_down(&mut to_born, target, 1, &mut ways[1]),
            ];
            if is_longer == [false, false] {
                break;
            }
        }
        let kept = self.end(to_kept, target, square, 0);
        let born = self.end(to_born, target, square, 1);
        let edge = minus(born.place, kept.place);
        let target = near(kept.place, born.place, 0.7);
        let third = self.up(record, target, dot(edge, edge), &mut ways[2]);
        [kept, born, third]
    }

    /// Section 9.6: a step down from a child of a node, to a child of that child; whether there is one.
    fn step_down(&mut self, at: &mut (u32, usize), target: Vector, corner: usize, way: &mut Way) -> bool {
        let Child::Node(child) = self.nodes[&at.0].children[at.1] else { return false };
        let q = &self.nodes[&child];
        let (k, b) = (q.born - q.start, q.end - q.born);
        let ratio = if k / 2 > b {
            0
        } else if b / 2 > k {
            2
        } else {
            1
        };
        let level = [2, 5, 16].into_iter().filter(|limit| q.size() > *limit).count();
        let d = q.displacement();
        let inverse = 1.0 / dot(d, d).max(f32::MIN_POSITIVE);
        let axis = d.map(|value| value * inverse);
        let along = dot(minus(target, q.places[KEPT]), axis);
        let along = within((along * 5.0 + 4.0) as i32, 0, 12) as usize;
        let context = (((4 * ratio + level) * 13 + along) * 4 + way.before()) * 3 + corner;
        let is_born = self.coded.decision(Choice::Down, context);
        way.taken.push(is_born);
        *at = (child, usize::from(is_born));
        true
    }

    /// Section 9.6: where a way down ends.
    fn end(&mut self, (name, side): (u32, usize), target: Vector, square: f32, corner: usize) -> Corner {
        let node = &self.nodes[&name];
        let (start, end) = node.leaves(side);
        let place = node.places[side];
        if node.children[side] == Child::Leaf {
            return Corner { leaf: start, place, is_placed: true };
        }
        let leaf = self.outside(start, end, target, square, corner);
        Corner { leaf, place, is_placed: leaf == start }
    }

    /// Section 9.6: up from a node, and down to a leaf.
    fn up(&mut self, from: u32, target: Vector, square: f32, way: &mut Way) -> Corner {
        let mut name = from;
        let half_edge = 0.5 * square.sqrt();
        let mut height = 0;
        loop {
            let (parent, side) = self.nodes[&name].parent.unwrap();
            let p = &self.nodes[&parent];
            let other = 1 - side;
            let mut is_there = p.parent.is_none();
            if !is_there {
                let (radius, place) = (p.radii[other], p.places[other]);
                let to = minus(target, place);
                let reach = radius + half_edge;
                let far = within(half(dot(to, to)) - half(reach * reach) + 8, 0, 13) as usize;
                let thick = if radius <= 0.0 {
                    0
                } else if radius < half_edge {
                    1
                } else if radius < 4.0 * half_edge {
                    2
                } else {
                    3
                };
                let (start, end) = p.leaves(other);
                let size = match end - start {
                    1 => 0,
                    2..=8 => 1,
                    _ => 2,
                };
                let context = (((far * 4 + thick) * 4 + way.before()) * 3 + size) * 3 + height.min(2);
                is_there = self.coded.decision(Choice::Up, context);
                way.taken.push(is_there);
            }
            if is_there {
                let mut at = (parent, other);
                while self.step_down(&mut at, target, 2, way) {}
                return self.end(at, target, square, 2);
            }
            name = parent;
            height += 1;
        }
    }

    /// Section 9.6: a leaf elsewhere.
    fn outside(&mut self, start: u32, end: u32, target: Vector, square: f32, corner: usize) -> u32 {
        let mut nearest: Option<(f32, u32)> = None;
        for (leaf, place) in self.outside.into_iter().flatten() {
            let off = minus(place, target);
            let distance = dot(off, off);
            if (start..end).contains(&leaf) && distance.is_finite() && nearest.is_none_or(|(least, _)| distance < least)
            {
                nearest = Some((distance, leaf));
            }
        }
        let leaf = match nearest {
            Some((distance, known)) => {
                let context = within(((half(distance) - half(square)) >> 1) + 4, 0, 7) as usize;
                match self.coded.difference(Family::Outside, context) {
                    0 => return known,
                    difference => (i64::from(known) + difference) as u32,
                }
            }
            None if self.coded.decision(Choice::FirstLeaf, corner) => start,
            None => {
                let last = end - start - 2;
                start + 1 + self.coded.raw(u32::BITS - last.leading_zeros()) as u32
            }
        };
        assert!((start..end).contains(&leaf));
        self.outside[self.outside_count % 16] = Some((leaf, target));
        self.outside_count += 1;
        leaf
    }

    /// Section 9.7.
    fn decode_normals(&mut self) {
        let mix = |leaf: u32| {
            let y = leaf.wrapping_mul(0x9e37_79b1);
            y ^ y >> 15
        };
        let mut sums: BTreeMap<u32, (Vector, i32, u32)> =
            self.records.iter().map(|record| (*record, ([0.0; 3], 0, 0))).collect();
        for record in &self.records {
            for (is_right, corners) in &self.triangles[record] {
                if !corners.iter().all(|corner| corner.is_placed) {
                    continue;
                }
                let corners = turned(*is_right, corners);
                let [a, b, c] = corners.map(|corner| corner.place);
                let normal = cross(minus(b, a), minus(c, a));
                for corner in 0..3 {
                    let Some((sum, count, open)) = sums.get_mut(&corners[corner].leaf) else { continue };
                    *sum = each(*sum, normal, |sum, value| sum + value);
                    *count += 1;
                    let [follows, before] = [corners[(corner + 1) % 3].leaf, corners[(corner + 2) % 3].leaf];
                    *open = open.wrapping_add(mix(follows)).wrapping_sub(mix(before));
                }
            }
        }
        for record in &self.records {
            let (sum, count, open) = sums[record];
            let (context, expected) = match count {
                0 => (1, encoded_normal(self.nodes[record].normals[BORN])),
                _ if open == 0 && count > 2 => (0, encoded_normal(sum)),
                _ => (1 + count.min(6) as usize, encoded_normal(sum)),
            };
            let off = self.coded.difference(Family::FirstNormal, context) as i32;
            let level = match off.abs() {
                0 => 0,
                1..=4 => 1,
                _ => 2,
            };
            let u = expected.0 + off;
            let v = expected.1 + self.coded.difference(Family::SecondNormal, 3 * context + level) as i32;
            assert!((0..1024).contains(&u) && (0..1024).contains(&v));
            self.normals.insert(*record, (u + 1024 * v) as u32);
        }
        for record in self.records.clone() {
            self.nodes.get_mut(&record).unwrap().normals[BORN] = decoded_normal(self.normals[&record]);
            for side in [KEPT, BORN] {
                if let Child::Node(child) = self.nodes[&record].children[side] {
                    self.nodes.get_mut(&child).unwrap().normals[KEPT] = self.nodes[&record].normals[side];
                }
            }
        }
    }

    /// Section 9.8.
    fn decode_cones(&mut self) {
        let mut least: BTreeMap<u32, usize> = BTreeMap::new();
        for record in self.records.iter().rev() {
            let node = &self.nodes[record];
            let mut classes = [0; 2];
            for side in [BORN, KEPT] {
                let context = match node.children[side] {
                    Child::Leaf => continue,
                    Child::Node(child) => least[&child],
                    Child::Elsewhere => 17,
                };
                classes[side] = self.coded.symbol(Family::Cone, context);
                self.cones.insert((*record, side), classes[side] as u8);
            }
            let cosine = dot(node.normals[KEPT], node.normals[BORN]);
            let turned = COSINES.iter().filter(|known| **known > cosine).count();
            least.insert(*record, classes[KEPT].max(classes[BORN] + turned).min(16));
        }
    }

    /// Section 9.9.
    fn decode_wedges(&mut self, appearance: &Appearance) {
        for record in self.records.clone() {
            let kept = self.wedges[&self.nodes[&record].start].clone();
            let k = kept.len();
            let count = if appearance.has_seams { self.coded.place(Family::WedgeCount, (k - 1).min(3)) + 1 } else { 1 };
            assert!(count < 1024);
            let (mut wedges, mut images) = (Vec::new(), Vec::new());
            for i in 0..count {
                let image = match k {
                    1 => 0,
                    _ => self.coded.place(Family::WedgeImage, 4 * i.min(3) + (k - 2).min(3)),
                };
                wedges.push(self.wedge(appearance, record, &kept[image], i == 0));
                images.push(image);
            }
            self.wedges.insert(record, wedges);
            self.images.insert(record, images);
        }
        if appearance.has_seams {
            self.decode_subtree_wedges();
            self.number_wedges();
            self.decode_corner_wedges();
        }
    }

    /// What a wedge has itself.
    fn wedge(&mut self, appearance: &Appearance, record: u32, image: &Wedge, is_first: bool) -> Wedge {
        let [normals, colours, textures, materials] = appearance.kinds;
        let mut wedge = PLAIN;
        if materials {
            wedge.material = match self.coded.symbol(Family::Material, usize::from(is_first)) {
                0 => image.material,
                _ => self.coded.amount(Family::MaterialNumber, 0),
            };
        }
        if textures {
            let d = self.nodes[&record].displacement();
            let expected = log(dot(d, d)) + appearance.texture_density;
            let x = self.coded.number(Family::FirstTexture, 0, expected);
            let level = level(x as f32, expected);
            let y = self.coded.number(Family::SecondTexture, 9 * level, expected);
            wedge.texture = [i64::from(image.texture[0]) + x, i64::from(image.texture[1]) + y].map(|value| {
                assert!(value.abs() <= 1 << 23);
                value as i32
            });
        }
        if colours {
            let [red, green, blue, alpha] = image.colour.map(i64::from);
            let by_green = self.coded.near(Family::Colour, 0, 0);
            let by_red = self.coded.near(Family::Colour, 1, by_green);
            let by_blue = self.coded.near(Family::Colour, 2, by_red);
            let by_alpha = self.coded.near(Family::Colour, 3, 0);
            let expected = |channel: i64| (channel + by_green).clamp(0, 255);
            wedge.colour = [expected(red) + by_red, green + by_green, expected(blue) + by_blue, alpha + by_alpha]
                .map(|channel| channel.try_into().unwrap());
        }
        let of_record = self.normals[&record];
        if normals && appearance.has_seams {
            let j = usize::from(!is_first);
            let a = self.coded.near(Family::FirstWedgeNormal, j, 0);
            let b = self.coded.near(Family::SecondWedgeNormal, j, a);
            let (u, v) = (i64::from(of_record % 1024) + a, i64::from(of_record / 1024) + b);
            assert!((0..1023).contains(&u) && (0..1023).contains(&v));
            wedge.normal = (u + 1024 * v) as u32;
        } else if normals {
            wedge.normal = of_record;
        }
        if !appearance.has_seams {
            (wedge.number, wedge.end) = (record, record + 1);
        }
        wedge
    }

    /// The leaf at which a child of a node stands.
    fn stands_at(&self, name: u32, side: usize) -> u32 {
        self.nodes[&name].leaves(side).0
    }

    fn decode_subtree_wedges(&mut self) {
        for (record, side) in self.splitting_children() {
            if self.nodes[&record].children[side] != Child::Elsewhere {
                continue;
            }
            let (start, end) = self.nodes[&record].leaves(side);
            let sizes = match self.wedges[&start].len() {
                1 => vec![end - start + self.coded.amount(Family::SubtreeWedges, 0)],
                count => (0..count).map(|_| 1 + self.coded.amount(Family::SubtreeWedges, 1)).collect(),
            };
            self.below.insert((record, side), sizes);
        }
    }

    fn number_wedges(&mut self) {
        // How many turn into each wedge of the leaf at which a record's node stands, and at which its children stand.
        let mut of_nodes: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        let mut of_children: BTreeMap<(u32, usize), Vec<u32>> = BTreeMap::new();
        for record in self.records.iter().rev() {
            for side in [KEPT, BORN] {
                let sizes = match self.nodes[record].children[side] {
                    Child::Leaf => vec![1; self.wedges[&self.stands_at(*record, side)].len()],
                    Child::Node(child) => of_nodes[&child].clone(),
                    Child::Elsewhere => self.below[&(*record, side)].clone(),
                };
                of_children.insert((*record, side), sizes);
            }
            let mut sizes = of_children[&(*record, KEPT)].clone();
            for (image, size) in self.images[record].iter().zip(&of_children[&(*record, BORN)]) {
                sizes[*image] += size;
            }
            of_nodes.insert(*record, sizes);
        }
        for root in &self.records[..self.root_count] {
            let expected = match self.nodes[root].parent {
                None => self.wedges[&self.nodes[root].start].iter().map(|wedge| wedge.end - wedge.number).collect(),
                Some((parent, side)) => self.known_sizes(parent, side),
            };
            assert_eq!(of_nodes[root], expected);
        }
        for record in &self.records {
            let kept = &self.wedges[&self.nodes[record].start];
            let mut next: Vec<u32> =
                kept.iter().zip(&of_children[&(*record, KEPT)]).map(|(wedge, size)| wedge.number + size).collect();
            let born = self.wedges.get_mut(record).unwrap();
            let images = &self.images[record];
            for ((wedge, image), size) in born.iter_mut().zip(images).zip(&of_children[&(*record, BORN)]) {
                wedge.number = next[*image];
                next[*image] += size;
                wedge.end = next[*image];
            }
        }
    }

    /// How many wedges of a subtree that is in no page below the one at hand turn into each at its root: up to the next one that
    /// is known to turn into it and is not of the subtree.
    fn known_sizes(&self, parent: u32, side: usize) -> Vec<u32> {
        let (start, end) = self.nodes[&parent].leaves(side);
        let others: Vec<u32> = self
            .wedges
            .iter()
            .filter(|(leaf, _)| !(start..end).contains(leaf))
            .flat_map(|(_, wedges)| wedges.iter().map(|wedge| wedge.number))
            .collect();
        let size = |wedge: &Wedge| {
            let above = others.iter().copied().filter(|number| (wedge.number + 1..wedge.end).contains(number));
            above.min().unwrap_or(wedge.end) - wedge.number
        };
        self.wedges[&start].iter().map(size).collect()
    }

    fn decode_corner_wedges(&mut self) {
        let first_leaves: Vec<u32> = self.model.trees.iter().map(|tree| tree.start).collect();
        // All first leaves of trees count as one.
        let mut last: BTreeMap<Option<u32>, usize> = BTreeMap::new();
        for record in self.records.clone() {
            let mut found = Vec::new();
            for (_, corners) in self.triangles[&record].clone() {
                let mut numbers = [0; 3];
                for (which, corner) in corners.into_iter().enumerate() {
                    numbers[which] = if corner.is_placed {
                        let wedges = &self.wedges[&corner.leaf];
                        let mut place = 0;
                        if wedges.len() > 1 {
                            let leaf = Some(corner.leaf).filter(|leaf| !first_leaves.contains(leaf));
                            let before = last.get(&leaf).map_or(0, |place| 1 + place.min(&2));
                            let context = ((wedges.len() - 2).min(3) * 3 + which) * 4 + before;
                            place = self.coded.place(Family::CornerWedge, context);
                            last.insert(leaf, place);
                        }
                        wedges[place].number
                    } else {
                        self.wedge_elsewhere(corner.leaf)
                    };
                }
                found.push(numbers);
            }
            self.corner_wedges.insert(record, found);
        }
    }

    /// The wedge of a corner at a leaf elsewhere.
    fn wedge_elsewhere(&mut self, leaf: u32) -> u32 {
        let is_there = |(name, side): &(u32, usize)| {
            let (start, end) = self.nodes[name].leaves(*side);
            self.nodes[name].children[*side] == Child::Elsewhere && (start..end).contains(&leaf)
        };
        let (name, side) = self.nodes.keys().flat_map(|name| [(*name, KEPT), (*name, BORN)]).find(is_there).unwrap();
        let sizes = match self.below.get(&(name, side)) {
            Some(sizes) => sizes.clone(),
            None => self.known_sizes(name, side),
        };
        let (start, end) = self.nodes[&name].leaves(side);
        let wedges = &self.wedges[&start];
        if sizes == [end - start] {
            return wedges[0].number + (leaf - start);
        }
        let all: Vec<u32> =
            wedges.iter().zip(sizes).flat_map(|(wedge, size)| wedge.number..wedge.number + size).collect();
        let bits = u32::BITS - (all.len() as u32 - 1).leading_zeros();
        all[self.coded.raw(bits) as usize]
    }

    /// The decoded page's records: sections 5 and 6.
    fn records(&self, children: &[(u32, u64, u32)], entries: &[usize]) -> Vec<Record> {
        let mut below: Vec<(u32, (u32, usize))> = Vec::new();
        for (record, side) in self.splitting_children() {
            if self.nodes[&record].children[side] == Child::Elsewhere {
                below.push((self.nodes[&record].leaves(side).0, (record, side)));
            }
        }
        below.sort_unstable();
        assert_eq!(below.len(), entries.iter().sum::<usize>());
        let mut targets = BTreeMap::new();
        let mut next = below.into_iter();
        for (child, count) in entries.iter().enumerate() {
            let is_tree = |record: usize| {
                self.model.trees.iter().any(|tree| tree.page == children[child].0 && tree.record == record)
            };
            let records = (0..).filter(|record| !is_tree(*record));
            for ((_, name), record) in next.by_ref().take(*count).zip(records) {
                targets.insert(name, (child, record));
            }
        }
        let mut next_here = self.root_count;
        let mut found = Vec::new();
        for record in &self.records {
            let node = &self.nodes[record];
            let entry = |side: usize| {
                let (child_page, target) = match node.children[side] {
                    Child::Leaf => return None,
                    Child::Node(_) => {
                        next_here += 1;
                        (None, next_here - 1)
                    }
                    Child::Elsewhere => {
                        let (child, target) = targets[&(*record, side)];
                        (Some(child), target)
                    }
                };
                let id = self.ids[&(*record, side)];
                Some(Entry {
                    id,
                    switch: switch_value(id, self.model.exponent),
                    radius: node.radii[side],
                    cone: cone(self.cones[&(*record, side)], node.normals[side], node.is_inward),
                    child_page,
                    record: target,
                })
            };
            let children = [KEPT, BORN].map(entry);
            // The wedges of their corners go with the triangles.
            let mut triangles = Vec::new();
            for (index, (is_right, corners)) in self.triangles[record].iter().enumerate() {
                let wedges = self.corner_wedges.get(record).map(|wedges| turned(*is_right, &wedges[index]));
                triangles.push((turned(*is_right, corners).map(|corner| corner.leaf), wedges));
            }
            triangles.sort_unstable();
            found.push(Record {
                born_leaf: *record,
                position: node.places[BORN],
                normal: self.normals[record],
                children,
                triangles: triangles.iter().map(|(corners, _)| *corners).collect(),
                wedges: self.wedges.get(record).cloned().unwrap_or_default(),
                corner_wedges: triangles.iter().filter_map(|(_, wedges)| *wedges).collect(),
            });
        }
        found
    }
}

/// One of the three ways of a triangle.
struct Way {
    /// What was decided on it.
    taken: Vec<bool>,
    /// What was decided on that of the record's first triangle, if this is not the first.
    first: Option<Vec<bool>>,
}

impl Way {
    fn new() -> Self {
        Way { taken: Vec::new(), first: None }
    }

    /// What the first did here.
    fn before(&self) -> usize {
        match &self.first {
            None => 0,
            Some(first) => match first[..first.len().min(32)].strip_prefix(self.taken.as_slice()) {
                Some([decision, ..]) => 1 + usize::from(*decision),
                _ => 3,
            },
        }
    }
}

fn turned<T: Copy>(is_right: bool, [kept, born, third]: &[T; 3]) -> [T; 3] {
    if is_right { [*kept, *third, *born] } else { [*kept, *born, *third] }
}

/// The axes, that along which the surface faces most last.
fn axes(normal: Vector) -> [usize; 3] {
    let [x, y, z] = normal.map(f32::abs);
    if z >= x && z >= y {
        [0, 1, 2]
    } else if y >= x {
        [2, 0, 1]
    } else {
        [1, 2, 0]
    }
}

fn steep(component: f32) -> i32 {
    log((1.0 - component * component).max(1.0 / 64.0))
}

fn level(first: f32, expected: i32) -> usize {
    match log(first * first) - expected {
        ..-64 => 0,
        -64..-16 => 1,
        -16..16 => 2,
        _ => 3,
    }
}

const COSINES: [f32; 16] = [
    1.0,
    0.995_184_7,
    0.980_785_28,
    0.956_940_34,
    0.923_879_5,
    0.881_921_3,
    0.831_469_6,
    0.773_010_45,
    std::f32::consts::FRAC_1_SQRT_2,
    0.634_393_3,
    0.555_570_23,
    0.471_396_74,
    0.382_683_43,
    0.290_284_67,
    0.195_090_32,
    0.098_017_14,
];
const SINES: [u8; 16] = [2, 25, 50, 74, 98, 120, 142, 162, 180, 197, 212, 225, 235, 244, 250, 253];

fn cone(class: u8, normal: Vector, is_inward: bool) -> ([i8; 3], u8) {
    if class == 16 {
        return ([0; 3], 255);
    }
    let length = if is_inward { -127.0 } else { 127.0 };
    (normal.map(|value| nearest(length * value) as i8), SINES[usize::from(class)])
}
