//! How like the picture of a front is to that of the full mesh, as one camera sees them both.
//!
//! - *Points of the surface.* Each point of a picture in which a surface is seen is taken back to the place that it shows. How far
//!   that is from the nearest triangle of the other mesh is told in footprints, that is heights of a point of the picture at the
//!   depth of the place. Both ways. (A surface is drawn with corners rounded to 1/256 of a point: so far a place may be off.)
//! - *Outline.* A point belongs to the outline where a surface is seen, and none is at the point above, below, to the left or to
//!   the right. How many are within [`OUTLINE_REACH`] points of one of the other picture's outline. Both ways.
//! - *Holes.* Both pictures have a depth at each point, which is infinite where nothing is seen. A point is *seen through* where
//!   the front's is beyond that of the full mesh at that point and at all within a reach about it, by more than that reach in
//!   footprints. It is a *hole* where nothing at all is seen. So there is no hole within the reach of the outline of the full
//!   mesh; a plane that is off by the reach, in whatever direction, is not seen through, whatever its slope; and near the border
//!   of the picture, where the reach leads out of it, nothing is said.
//!   What is thinner than a point is in one picture and not in the other: a chink between two parts of the mesh may be off by a
//!   hair and so be seen. So the full mesh is drawn again about such a point, up to [`FINEST`] times as fine. Where it is as deep
//!   anywhere within the reach, the chink is its own, and the point is neither seen through nor a hole. The first
//!   [`MOST_LOOKED_AT`] points are looked at so.
//! - *Cracks.* A point that is seen through, hole or not, is in a crack where the front is nearer on both of two opposite sides,
//!   a point or two away: where it is thin.
//! - *Pinholes.* A point whose front is nearer on both of two opposite sides, by more than [`THIN_STEP`] footprints, whatever the full
//!   mesh is like, though the front, drawn [`FINEST`] times as fine within the point, is nowhere as deep: what the drawing has
//!   left open between triangles. Of many such points [`MOST_LOOKED_AT`] are looked at.
//!
//! Memory: 4 bytes for each point of each picture. Time: a microsecond or so for each point on each way.

use render::{Buffers, Picture, Projection, draw};
use vdt::workers::for_each;

use super::surface::Surface;

/// A place is near the other mesh within so many footprints.
pub const NEAR: f64 = 1.5;
/// A point of an outline is at the other one within so many points.
pub const OUTLINE_REACH: f64 = 2.0;
/// Farther than so many footprints nothing is looked for.
const FARTHEST: f64 = 64.0;
/// How far the sides of a crack are from its middle, in points.
const CRACK_REACH: i64 = 2;
/// The directions across a crack.
const ACROSS: [(i64, i64); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];

/// How many times as fine the full mesh is drawn about a point that is seen through.
const FINEST: f64 = 32.0;
/// How large that picture may be, in points.
const FINE_SIZE: f64 = 1024.0;
/// For so many points of a picture.
const MOST_LOOKED_AT: usize = 500;
/// What is nearer by so many footprints is another surface, or another part of it.
const THIN_STEP: f64 = 2.0;
/// Of how many points that are seen through the place is told.
const MOST_TOLD: usize = 20;

/// A picture, and the surface that is seen in it.
#[derive(Debug, Clone, Copy)]
pub struct Side<'a> {
    /// The picture.
    pub picture: &'a Picture,
    /// What was drawn.
    pub buffers: Buffers<'a>,
    /// All its triangles.
    pub surface: &'a Surface,
}

/// How many of those that were looked at are as they should be.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Share {
    /// How many were looked at.
    pub all: u64,
    /// How many are as they should be.
    pub good: u64,
    /// The farthest that was found, in footprints or points; infinite where it was not found.
    pub worst: f64,
}

impl Share {
    fn of(distance: f64, most: f64) -> Self {
        Share { all: 1, good: u64::from(distance <= most), worst: distance }
    }

    /// With others.
    pub fn add(&mut self, other: Share) {
        self.all += other.all;
        self.good += other.good;
        self.worst = self.worst.max(other.worst);
    }

    /// In percent; all where there are none.
    pub fn percent(&self) -> f64 {
        if self.all == 0 { 100.0 } else { 100.0 * self.good as f64 / self.all as f64 }
    }
}

/// What two pictures of a camera have in common. The first of each pair is that of the front.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Likeness {
    /// Places that are near the other mesh.
    pub near: [Share; 2],
    /// Points of the outline that are at the other one.
    pub outline: [Share; 2],
    /// Points that may be holes: those in which the full mesh is seen, with all of the reach in the picture.
    pub looked_at: u64,
    /// Points in which the full mesh is seen, well within its outline, and the front is not.
    pub holes: u64,
    /// Those in which something behind is seen.
    pub seen_through: u64,
    /// Those of both that are thin.
    pub cracks: u64,
    /// Points that are none of these because the full mesh has a chink there that is thinner than a point.
    pub chinks: u64,
    /// Points that the drawing has left open between triangles.
    pub pinholes: u64,
    /// Where the first of those are that are seen through or holes: columns and rows.
    pub gaps_at: Vec<[u32; 2]>,
}

/// A point in which the front is seen through.
#[derive(Debug, Clone, Copy)]
struct Gap {
    column: u32,
    row: u32,
    seen: f64,
    is_thin: bool,
}

impl Likeness {
    /// Of the front's picture and that of the full mesh, with so much reach about a hole, in points.
    pub fn of(projection: &Projection, front: Side<'_>, full: Side<'_>, reach: f64, threads: usize) -> Self {
        let [seen, all] = [front, full].map(|side| Depths::of(side.picture));
        let outlines = [seen.outline(), all.outline()];
        let mut likeness = Likeness {
            near: [near(projection, &seen, full.surface, threads), near(projection, &all, front.surface, threads)],
            outline: [seen.at_outline(&outlines[0], &outlines[1]), all.at_outline(&outlines[1], &outlines[0])],
            ..Likeness::default()
        };
        // With more reach there is no point that has all of it in the picture.
        let half = 0.5 * f64::from(seen.width.min(seen.height));
        let hidden = Hidden { projection, front: &seen, full: &all, reach, offsets: disc(reach.min(half)) };
        likeness.looked_at = hidden.looked_at();
        likeness.pinholes = hidden.pinholes(front.buffers, threads);
        let gaps: Vec<Gap> = by_rows(&seen, threads, |_: &mut (), row| hidden.in_row(row)).concat();
        for (number, gap) in gaps.iter().enumerate() {
            if number < MOST_LOOKED_AT && hidden.is_as_deep_nearby(gap, full.buffers, reach, reach) {
                likeness.chinks += 1;
                continue;
            }
            likeness.holes += u64::from(gap.seen.is_infinite());
            likeness.seen_through += u64::from(gap.seen.is_finite());
            likeness.cracks += u64::from(gap.is_thin);
            if likeness.gaps_at.len() < MOST_TOLD {
                likeness.gaps_at.push([gap.column, gap.row]);
            }
        }
        likeness
    }
}

/// The depths of a picture: infinite where nothing is seen.
struct Depths {
    width: u32,
    height: u32,
    depths: Vec<f32>,
}

impl Depths {
    fn of(picture: &Picture) -> Self {
        Depths { width: picture.width(), height: picture.height(), depths: picture.distances().collect() }
    }

    fn place(&self, column: i64, row: i64) -> Option<usize> {
        let [column, row] = [u32::try_from(column).ok()?, u32::try_from(row).ok()?];
        (column < self.width && row < self.height).then(|| row as usize * self.width as usize + column as usize)
    }

    /// The depth at a point, if it is in the picture.
    fn at(&self, column: i64, row: i64) -> Option<f64> {
        self.place(column, row).map(|place| self.depths[place].into())
    }

    fn row(&self, row: usize) -> &[f32] {
        &self.depths[row * self.width as usize..][..self.width as usize]
    }

    /// Which points belong to the outline.
    fn outline(&self) -> Vec<bool> {
        let is_outside = |column: i64, row: i64| self.at(column, row).is_some_and(f64::is_infinite);
        let belongs = |(place, depth): (usize, &f32)| {
            let (column, row) = ((place % self.width as usize) as i64, (place / self.width as usize) as i64);
            let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)];
            depth.is_finite() && beside.iter().any(|(across, down)| is_outside(column + across, row + down))
        };
        self.depths.iter().enumerate().map(belongs).collect()
    }

    /// How many points of an outline are at another one.
    fn at_outline(&self, outline: &[bool], other: &[bool]) -> Share {
        let mut share = Share::default();
        let offsets = disc(FARTHEST);
        for place in (0..outline.len()).filter(|place| outline[*place]) {
            let (column, row) = ((place % self.width as usize) as i64, (place / self.width as usize) as i64);
            let nearest = offsets
                .iter()
                .find(|(across, down)| self.place(column + across, row + down).is_some_and(|place| other[place]));
            let distance = nearest.map_or(f64::INFINITY, |(across, down)| (*across as f64).hypot(*down as f64));
            share.add(Share::of(distance, OUTLINE_REACH));
        }
        share
    }
}

/// The ways to all points within a distance, the shortest first.
fn disc(reach: f64) -> Vec<(i64, i64)> {
    let most = reach.floor() as i64;
    let square = |(across, down): &(i64, i64)| across * across + down * down;
    let all = (-most..=most).flat_map(|down| (-most..=most).map(move |across| (across, down)));
    let mut ways: Vec<_> = all.filter(|way| square(way) as f64 <= reach * reach).collect();
    ways.sort_by_key(square);
    ways
}

/// What some threads make of the rows of a picture, each with something of its own.
fn by_rows<W: Default + Send, R: Send>(
    depths: &Depths,
    threads: usize,
    work: impl Fn(&mut W, usize) -> R + Sync,
) -> Vec<R> {
    let mut own: Vec<W> = (0..threads.max(1)).map(|_| W::default()).collect();
    let done = for_each(&mut own, depths.height as usize, |own, row| Ok::<_, std::convert::Infallible>(work(own, row)));
    match done {
        Ok(results) => results,
        Err(never) => match never {},
    }
}

/// How many of the places that are seen in a picture are near a surface.
fn near(projection: &Projection, seen: &Depths, surface: &Surface, threads: usize) -> Share {
    let rows = by_rows(seen, threads, |guess: &mut usize, row| {
        let mut share = Share::default();
        for (column, depth) in (0..).zip(seen.row(row)).filter(|(_, depth)| depth.is_finite()) {
            let depth = f64::from(*depth);
            let (place, height) = (projection.seen_at(column, row as u32, depth), projection.point_height(depth));
            let distance = surface.distance(place.to_array(), FARTHEST * height, guess);
            share.add(Share::of(distance / height, NEAR));
        }
        share
    });
    let mut share = Share::default();
    rows.into_iter().for_each(|row| share.add(row));
    share
}

/// Where the front is seen through.
struct Hidden<'a> {
    projection: &'a Projection,
    front: &'a Depths,
    full: &'a Depths,
    reach: f64,
    offsets: Vec<(i64, i64)>,
}

impl Hidden<'_> {
    /// The points of a row with all of the reach in the picture: their columns and both depths.
    fn inner(&self, row: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let border = self.border();
        let is_inner = row >= border && row + border < self.front.height as usize;
        let columns = if is_inner { border..(self.front.width as usize).saturating_sub(border) } else { 0..0 };
        let (seen, full) = (self.front.row(row), self.full.row(row));
        columns.map(|column| (column, seen[column].into(), full[column].into()))
    }

    fn looked_at(&self) -> u64 {
        let in_row = |row| self.inner(row).filter(|(.., full)| full.is_finite()).count() as u64;
        (0..self.front.height as usize).map(in_row).sum()
    }

    /// The points of a row in which the front is seen through.
    fn in_row(&self, row: usize) -> Vec<Gap> {
        let mut gaps = Vec::new();
        for (column, seen, full) in self.inner(row) {
            let place = (column as i64, row as i64);
            if full.is_finite() && self.is_beyond(seen, full, self.reach) && self.is_seen_through(seen, place) {
                let is_thin = self.is_thin(seen, place, self.reach);
                gaps.push(Gap { column: column as u32, row: row as u32, seen, is_thin });
            }
        }
        gaps
    }

    /// The points that are open only as they are drawn.
    fn pinholes(&self, front: Buffers<'_>, threads: usize) -> u64 {
        let thin: Vec<Vec<Gap>> = by_rows(self.front, threads, |_: &mut (), row| {
            let columns = (0..).zip(self.front.row(row)).map(|(column, seen)| (column, f64::from(*seen)));
            let thin = columns.filter(|(column, seen)| self.is_thin(*seen, (*column, row as i64), THIN_STEP));
            thin.map(|(column, seen)| Gap { column: column as u32, row: row as u32, seen, is_thin: true }).collect()
        });
        let thin: Vec<Gap> = thin.concat();
        let some = thin.iter().step_by(thin.len().div_ceil(MOST_LOOKED_AT).max(1));
        some.filter(|gap| !self.is_as_deep_nearby(gap, front, 0.5, THIN_STEP)).count() as u64
    }

    /// How near the border of the picture nothing is said, in points.
    fn border(&self) -> usize {
        self.reach as usize
    }

    /// Whether something, drawn finer, is as deep somewhere within a distance of a point, but for so many footprints.
    fn is_as_deep_nearby(&self, gap: &Gap, drawn: Buffers<'_>, within: f64, footprints: f64) -> bool {
        let points = 2.0 * within.floor() + 1.0;
        // The middle of the point itself is the middle of one of the finer ones.
        let size = 2.0 * ((points * FINEST).min(FINE_SIZE) / 2.0).round() + 1.0;
        let mut fine = Picture::new(size as u32, size as u32);
        draw(&mut fine, &self.projection.part(gap.column, gap.row, points), drawn, false);
        let fine = Depths::of(&fine);
        let middle = 0.5 * (size - 1.0);
        let is_within = |place: usize| {
            let (across, down) = ((place % size as usize) as f64 - middle, (place / size as usize) as f64 - middle);
            across.hypot(down) * points / size <= within
        };
        let is_as_deep = |depth: &f32| !self.is_beyond(gap.seen, (*depth).into(), footprints);
        fine.depths.iter().enumerate().any(|(place, depth)| is_as_deep(depth) && is_within(place))
    }

    /// Whether a depth is beyond another one by more than so many footprints.
    fn is_beyond(&self, depth: f64, other: f64, footprints: f64) -> bool {
        depth > other + footprints * self.projection.point_height(other)
    }

    fn is_seen_through(&self, seen: f64, (column, row): (i64, i64)) -> bool {
        self.offsets.iter().all(|(across, down)| {
            self.full.at(column + across, row + down).is_some_and(|depth| self.is_beyond(seen, depth, self.reach))
        })
    }

    /// Whether the front is nearer on both of two opposite sides of a point, by more than so many footprints.
    fn is_thin(&self, seen: f64, (column, row): (i64, i64), footprints: f64) -> bool {
        let is_nearer = |across: i64, down: i64| {
            let depth = self.front.at(column + across, row + down);
            depth.is_some_and(|depth| self.is_beyond(seen, depth, footprints))
        };
        ACROSS.iter().any(|(across, down)| {
            [1, -1].iter().all(|side| (1..=CRACK_REACH).any(|far| is_nearer(side * far * across, side * far * down)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metanode::page::Normal;
    use navigator::Camera;

    const WIDTH: u32 = 160;
    const HEIGHT: u32 = 120;

    /// Seen from above: at depth 10, a point is a tenth of a unit.
    fn projection() -> Projection {
        let fov_degrees = 2.0 * 0.6_f64.atan().to_degrees();
        let camera: Camera = format!("0 0 10, 0 0 0, 0 1 0, {fov_degrees}").parse().unwrap();
        Projection::new(&camera, [0.0; 3], 20.0, WIDTH, HEIGHT).unwrap()
    }

    /// Two triangles to each of 8 × 8 squares of side 1 about the origin, at height `z`.
    fn board(z: f32) -> Vec<[[f32; 3]; 3]> {
        let squares = (0..64_u8).map(|square| (f32::from(square % 8) - 4.0, f32::from(square / 8) - 4.0));
        let triangles = squares.flat_map(|(x, y)| {
            let corner = |across: f32, up: f32| [x + across, y + up, z];
            [
                [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)],
                [corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
            ]
        });
        triangles.collect()
    }

    fn streams(triangles: &[[[f32; 3]; 3]]) -> (Vec<[f32; 4]>, Vec<[u32; 3]>) {
        let normal = f32::from_bits(Normal::UP.to_word());
        let vertices = triangles.as_flattened().iter().map(|[x, y, z]| [*x, *y, *z, normal]).collect();
        (vertices, (0..triangles.len() as u32).map(|first| [0, 1, 2].map(|place| 3 * first + place)).collect())
    }

    fn likeness(front: &[[[f32; 3]; 3]], full: &[[[f32; 3]; 3]]) -> Likeness {
        let streams = [front, full].map(streams);
        let buffers = [0, 1].map(|side| {
            let (vertices, triangles): &(Vec<_>, Vec<_>) = &streams[side];
            Buffers { vertices, triangles, ..Buffers::default() }
        });
        let pictures = buffers.map(|buffers| {
            let mut picture = Picture::new(WIDTH, HEIGHT);
            draw(&mut picture, &projection(), buffers, false);
            picture
        });
        let surfaces = [front, full].map(|triangles| Surface::new(triangles.iter().copied()));
        let [front, full] =
            [0, 1].map(|side| Side { picture: &pictures[side], buffers: buffers[side], surface: &surfaces[side] });
        Likeness::of(&projection(), front, full, 2.0, 2)
    }

    fn is_perfect(likeness: &Likeness) -> bool {
        let Likeness { near, outline, holes, seen_through, cracks, chinks, pinholes, .. } = likeness;
        near.iter().chain(outline).all(|share| share.all > 0 && share.good == share.all)
            && holes + seen_through + cracks + chinks + pinholes == 0
    }

    #[test]
    fn the_same_mesh_has_the_same_picture() {
        let same = likeness(&board(0.0), &board(0.0));
        assert!(is_perfect(&same), "{same:?}");
        assert_eq!((same.near[0].all, same.outline[0].all), (6400, 4 * 79));
        assert!(same.near[0].worst < 0.01 && same.outline[0].worst == 0.0, "{same:?}");
    }

    #[test]
    fn a_surface_that_is_off_is_seen_as_such() {
        // A point is a tenth of a unit.
        let near = likeness(&board(0.1), &board(0.0));
        assert!(is_perfect(&near) && (0.95..1.05).contains(&near.near[0].worst), "{near:?}");
        for shift in [0.3, -0.3] {
            let far = likeness(&board(shift), &board(0.0));
            assert!(far.near.iter().all(|share| share.good == 0 && (2.8..3.2).contains(&share.worst)), "{far:?}");
            // Seen from above it does not move by more than a point.
            assert!(far.outline.iter().all(|share| share.percent() == 100.0) && far.holes == 0, "{far:?}");
        }
        assert!(likeness(&board(-0.3), &board(0.0)).seen_through > 5000);
        // Aside, its middle is where it was, but not its sides.
        let aside: Vec<_> = board(0.0).into_iter().map(|corners| corners.map(|[x, y, z]| [x + 0.4, y, z])).collect();
        let aside = likeness(&aside, &board(0.0));
        assert!(aside.outline.iter().all(|share| share.percent() < 70.0 && share.worst == 4.0), "{aside:?}");
        assert!(aside.near.iter().all(|share| (95.0..99.5).contains(&share.percent())), "{aside:?}");
        // Two of four columns are farther than two points from the side of the other.
        assert_eq!((aside.holes, aside.seen_through, aside.cracks), (2 * 76, 0, 0), "{aside:?}");
    }

    #[test]
    fn a_triangle_that_is_missing_leaves_a_hole() {
        let mut front = board(0.0);
        front.remove(72);
        let holed = likeness(&front, &board(0.0));
        // Half a square of 10 × 10 points.
        assert!((40..60).contains(&holed.holes) && holed.seen_through == 0, "{holed:?}");
        assert!(holed.cracks > 0 && holed.cracks < holed.holes, "{holed:?}");
        assert_eq!(holed.near[0].percent(), 100.0);
        assert!(holed.near[1].percent() < 100.0 && holed.outline[0].percent() < 100.0, "{holed:?}");
        // With a floor below, it is seen through.
        let below = board(-2.0);
        let [front, full] = [front, board(0.0)].map(|top| [top, below.clone()].concat());
        let holed = likeness(&front, &full);
        assert!(holed.holes == 0 && (40..60).contains(&holed.seen_through), "{holed:?}");
        // It is in the mesh, not in the drawing.
        assert_eq!(holed.pinholes, 0);
    }

    /// A picture from which a line of points was lost, of a mesh that is whole.
    #[test]
    fn what_the_drawing_leaves_open_is_found() {
        let (vertices, triangles) = streams(&board(0.0));
        let whole = Buffers { vertices: &vertices, triangles: &triangles, ..Buffers::default() };
        let lost: Vec<_> = board(0.0)
            .into_iter()
            .map(|corners| {
                corners.map(|[x, y, z]| [if corners.iter().all(|[x, ..]| *x <= 0.0) { x - 0.1 } else { x }, y, z])
            })
            .collect();
        let (lost_vertices, lost_triangles) = streams(&lost);
        let lost_buffers = Buffers { vertices: &lost_vertices, triangles: &lost_triangles, ..Buffers::default() };
        let mut picture = Picture::new(WIDTH, HEIGHT);
        draw(&mut picture, &projection(), lost_buffers, false);
        let surface = Surface::new(board(0.0).into_iter());
        let pinholes = |buffers: Buffers<'_>| {
            let side = Side { picture: &picture, buffers, surface: &surface };
            // With the reach of a cold start: of holes nothing can be said.
            let likeness = Likeness::of(&projection(), side, side, 1e6, 2);
            assert_eq!((likeness.looked_at, likeness.holes), (0, 0));
            likeness.pinholes
        };
        assert!(pinholes(whole) >= 76, "{}", pinholes(whole));
        assert_eq!(pinholes(lost_buffers), 0);
    }

    #[test]
    fn a_crack_is_found_however_thin() {
        // One side of the board is off by half a point to the left, the other to the right: there a column is empty.
        let shift = |[x, y, z]: [f32; 3], left: bool| [if left { x - 0.05 } else { x + 0.05 }, y, z];
        let front: Vec<_> = board(0.0)
            .into_iter()
            .map(|corners| {
                let left = corners.iter().all(|[x, ..]| *x <= 0.0);
                corners.map(|corner| shift(corner, left))
            })
            .collect();
        let cracked = likeness(&front, &board(0.0));
        assert!(cracked.holes >= 70 && cracked.cracks == cracked.holes, "{cracked:?}");
        assert_eq!(cracked.near.map(|share| share.percent()), [100.0; 2], "{cracked:?}");
        // Where the full mesh has a chink itself, though between the middles of two points, it is none of the front's.
        let chink: Vec<_> = board(0.0)
            .into_iter()
            .map(|corners| {
                let left = corners.iter().all(|[x, ..]| *x <= 0.0);
                corners.map(|[x, y, z]| [if left { x - 0.03 } else { x + 0.03 }, y, z])
            })
            .collect();
        let chink = likeness(&front, &chink);
        assert_eq!((chink.holes, chink.cracks, chink.chinks), (0, 0, cracked.holes), "{chink:?}");
    }

    /// A slope that is off has other depths by far, and is not seen through.
    #[test]
    fn a_steep_slope_is_no_hole() {
        let steep = |off: f32| -> Vec<_> {
            board(0.0).into_iter().map(|corners| corners.map(|[x, y, _]| [x, y, 0.9 * (x + off) * 10.0])).collect()
        };
        let slope = |triangles: Vec<[[f32; 3]; 3]>| -> Vec<_> {
            triangles.into_iter().filter(|corners| corners.iter().all(|[.., z]| *z < 5.0)).collect()
        };
        let likeness = likeness(&slope(steep(0.05)), &slope(steep(0.0)));
        assert!(likeness.holes + likeness.seen_through + likeness.cracks == 0, "{likeness:?}");
        assert!(likeness.near[0].all > 400, "{likeness:?}");
    }
}
