//! What the wedges of a vertex turn into when it is collapsed, and whether the seams of the texture allow it.
//!
//! *Surfaces.* Two wedges at a vertex are of the same surface if they have the same material and texture coordinate
//! ([`Wedge::is_same_surface`]); colours and normals may jump within one. A triangle that vanishes has a wedge at both ends of
//! the edge, and so says what goes on into what.
//!
//! *The image* of a wedge a of the vertex that goes is, among the wedges of the vertex that stays:
//! - the one that a vanishing triangle has there which has a (the first one, if there are several);
//! - else, where a vanishing triangle has one of the same surface as a, the nearest to a in colour, then in normal, of those
//!   of the surface that this triangle has there;
//! - else the nearest of all, in material, then in place in the texture, colour, and normal.
//!
//! *The rule of seams*, asked of legal collapses only. An edge at the vertex that goes is a seam if its triangles have
//! different surfaces at either end of it.
//! - Every surface that goes on around the vertex has a vanishing triangle: a vertex on a seam moves along the seam only.
//! - Triangles that are of the same surface at the vertex, and share another corner, are so there, too: no seam ends at the
//!   vertex. So the end of a seam stays, and what vanishes says the same of each surface.
//! - A vertex with more than [`MOST_SURFACES`] surfaces is free of the rule, where textures count in the order of collapses:
//!   meshes whose every face has a chart of its own could not be simplified at all else. What such a collapse shows of a
//!   wrong part of the texture raises its key by as much as its area says; at coarse levels it is an approximation.
//!
//! What it reads are the star of the vertex that goes, and wedges.

use crate::tree::Wedge;

use super::live_mesh::LiveMesh;

/// A vertex with more surfaces may leave its seams: more than most textures have pieces anywhere, fewer than vertices have faces
/// where each has a piece of its own. (On the bunny of [`super::attribute_error`], to let all vertices do that, or those with
/// three, saves neither triangles nor colour errors: 0.1 to 0.5 % more at a tenth of the triangles.)
pub(super) const MOST_SURFACES: usize = 5;

/// A triangle at the vertex that goes.
#[derive(Debug, Clone, Copy)]
struct StarCorner {
    /// The place of its wedge at that vertex.
    own: u32,
    /// The place of its wedge at the vertex that stays, if it has that.
    at_stays: Option<u32>,
}

/// The images of the wedges of a vertex; kept from one collapse to the next for its memory.
#[derive(Debug, Default)]
pub(super) struct WedgeImages {
    /// For each wedge of the vertex that goes, the place of its image at the vertex that stays.
    images: Vec<u32>,
    star: Vec<StarCorner>,
    /// Other corners with several wedges: the vertex, and the surfaces at the vertex that goes and at it.
    others: Vec<(u32, u32, u32)>,
}

/// The place of the first wedge of the same surface.
fn surface(wedges: &[Wedge], place: u32) -> u32 {
    let own = &wedges[place as usize];
    // In the order of wedges, those of one surface are neighbours.
    let before = wedges[..place as usize].iter().rev().take_while(|other| other.is_same_surface(own));
    place - before.count() as u32
}

/// How far one wedge is from another, for wedges of the same surface.
fn look_distance(a: &Wedge, b: &Wedge) -> impl Ord + use<> {
    let of_channel = |channel: usize| u32::from(a.colour[channel].abs_diff(b.colour[channel])).pow(2);
    let colour: u32 = (0..4).map(of_channel).sum();
    let (of_a, of_b) = (a.normal.decode(), b.normal.decode());
    let d: [f32; 3] = std::array::from_fn(|axis| of_b[axis] - of_a[axis]);
    (colour, (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).to_bits())
}

/// How far one wedge is from another.
fn distance(a: &Wedge, b: &Wedge) -> impl Ord + use<> {
    let of_axis = |axis: usize| u64::from(a.texture[axis].abs_diff(b.texture[axis])).pow(2);
    (a.material != b.material, of_axis(0).saturating_add(of_axis(1)), look_distance(a, b))
}

impl WedgeImages {
    /// The images that were found last.
    pub fn images(&self) -> &[u32] {
        &self.images
    }

    /// Finds the images of the wedges of `gone` if it is collapsed onto `stays`.
    pub fn find(&mut self, mesh: &LiveMesh, gone: u32, stays: u32) {
        let (own, target) = (mesh.wedges.of(gone), mesh.wedges.of(stays));
        self.images.clear();
        self.images.resize(own.len(), 0);
        if target.len() > 1 {
            self.collect(mesh, gone, stays);
            for (place, image) in (0..).zip(&mut self.images) {
                *image = image_of(&self.star, own, target, place);
            }
        }
    }

    /// Collects the corners at `gone`, in the order of its star.
    fn collect(&mut self, mesh: &LiveMesh, gone: u32, stays: u32) {
        self.star.clear();
        for triangle in mesh.star(gone) {
            let triangle = *triangle as usize;
            let places = mesh.wedges.corners(triangle).places();
            let (mut own, mut at_stays) = (0, None);
            for (corner, place) in mesh.triangles[triangle].corners.into_iter().zip(places) {
                if corner == gone {
                    own = place;
                } else if corner == stays {
                    at_stays = Some(place);
                }
            }
            self.star.push(StarCorner { own, at_stays });
        }
    }

    /// Whether the collapse of `gone` onto `stays` keeps the rule of seams.
    pub fn keep_seams(&mut self, mesh: &LiveMesh, gone: u32, stays: u32) -> bool {
        let own_wedges = mesh.wedges.of(gone);
        let surfaces = own_wedges.chunk_by(|a, b| a.is_same_surface(b)).count();
        if surfaces > MOST_SURFACES && mesh.wedges.heeded().textures {
            return true;
        }
        self.collect(mesh, gone, stays);
        let star = &self.star;
        let goes_on = |corner: &StarCorner| {
            let is_same =
                |other: &StarCorner| own_wedges[other.own as usize].is_same_surface(&own_wedges[corner.own as usize]);
            star.iter().any(|other| other.at_stays.is_some() && is_same(other))
        };
        if own_wedges.len() > 1 && !star.iter().all(|corner| corner.at_stays.is_some() || goes_on(corner)) {
            return false;
        }
        self.others.clear();
        for (triangle, StarCorner { own, .. }) in mesh.star(gone).iter().zip(star) {
            let triangle = *triangle as usize;
            let places = mesh.wedges.corners(triangle).places();
            for (corner, place) in mesh.triangles[triangle].corners.into_iter().zip(places) {
                let there = mesh.wedges.of(corner);
                if corner != gone && there.len() > 1 {
                    self.others.push((corner, surface(own_wedges, *own), surface(there, place)));
                }
            }
        }
        self.others.sort_unstable();
        self.others.windows(2).all(|pair| (pair[0].0, pair[0].1) != (pair[1].0, pair[1].1) || pair[0].2 == pair[1].2)
    }
}

/// The place of the image of one of the wedges of the vertex that goes, among those of the vertex that stays.
fn image_of(star: &[StarCorner], own: &[Wedge], target: &[Wedge], place: u32) -> u32 {
    let wedge = &own[place as usize];
    let vanishing = || star.iter().filter_map(|corner| Some((corner.own, corner.at_stays?)));
    if let Some(image) = vanishing().filter(|(own, _)| *own == place).map(|(_, image)| image).min() {
        return image;
    }
    let is_same = |other: u32| own[other as usize].is_same_surface(wedge);
    let same = vanishing().filter(|(other, _)| is_same(*other)).map(|(_, image)| image).min();
    let nearest = match same {
        Some(image) => {
            let of_surface = (0..).zip(target).filter(|(_, other)| other.is_same_surface(&target[image as usize]));
            of_surface.min_by_key(|(_, other)| look_distance(wedge, other))
        }
        None => (0..).zip(target).min_by_key(|(_, other)| distance(wedge, other)),
    };
    nearest.map_or(0, |(image, _)| image)
}
