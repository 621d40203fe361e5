//! An endless random walk over the surface of a model, to try a navigator with: nothing in it repeats, but the same seed gives the same
//! walk, on any machine.
//!
//! The eye flies from one point near the surface to the next, as a body with inertia: its speed, its height and its direction
//! change all the time, and it looks around meanwhile. Every few seconds something happens: the eye jumps elsewhere, or, less
//! often, stops where it is. Who stops stays as long as the caller likes, and walks on with the next step.
//!
//! Time is counted in steps, [`STEPS_PER_SECOND`] to the second, not by a clock.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use metanode::header::ModelError;
use metanode::model::Model;

use crate::camera::Camera;
use crate::path::{Bounds, FIELD_OF_VIEW, SurfacePoint, surface_points};
use crate::random::Random;

/// How many steps are a second.
pub const STEPS_PER_SECOND: f64 = 60.0;
/// How long it takes until something happens, in seconds: at least, and at most.
const EVENTS: [f64; 2] = [1.5, 5.0];
/// One in so many events is a stop, the others are jumps.
const STOPS: u64 = 3;
/// How long the eye flies towards the same point, at most, in seconds.
const LONGEST_LEG: f64 = 3.0;
/// Heights above the surface, in diagonals of the model's bounding box.
const HEIGHTS: [f64; 2] = [0.003, 0.3];
/// Speeds, in diagonals a second.
const SPEEDS: [f64; 2] = [0.02, 0.8];
/// In how many seconds most of a change of the velocity, or of the direction of view, is done.
const INERTIA: f64 = 0.4;
/// How far the eye looks to the side, at most, in radians.
const SIDEWAYS: f64 = 1.2;
/// Among how many random points the nearest is the next one.
const CANDIDATES: usize = 6;
/// How many of the last points are not flown to again, where there are more.
const REMEMBERED: usize = 4;

/// What a step of the walk is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The eye has moved on.
    Flight,
    /// It is somewhere else.
    Jump,
    /// It stays where it is.
    Stop,
}

/// A random walk over the surface of a model.
#[derive(Debug, Clone)]
pub struct RandomWalk {
    bounds: Bounds,
    points: Vec<SurfacePoint>,
    random: Random,
    eye: DVec3,
    velocity: DVec3,
    /// Direction of view, of unit length.
    view: DVec3,
    /// Where the eye flies to, and the point of the surface below.
    goal: DVec3,
    below: DVec3,
    speed: f64,
    /// The indices of the last points.
    last: VecDeque<usize>,
    /// How fast the eye looks from side to side, in turns a second.
    looks: f64,
    /// Seconds until the eye flies elsewhere, and until something happens; and seconds since the start.
    leg_left: f64,
    event_left: f64,
    time: f64,
}

impl RandomWalk {
    /// A walk, which begins near the surface. It reads the root pages.
    pub fn new(model: &Model, seed: u64) -> Result<Self, ModelError> {
        let bounds = Bounds::of(model);
        let mut points = surface_points(model)?;
        if points.is_empty() {
            points.push(SurfacePoint { position: bounds.center, away: None });
        }
        let mut walk = RandomWalk {
            bounds,
            points,
            random: Random(seed),
            eye: DVec3::ZERO,
            velocity: DVec3::ZERO,
            view: DVec3::X,
            goal: DVec3::ZERO,
            below: DVec3::ZERO,
            speed: 0.0,
            last: VecDeque::with_capacity(REMEMBERED),
            looks: 0.0,
            leg_left: 0.0,
            event_left: 0.0,
            time: 0.0,
        };
        walk.event_left = walk.random.between(EVENTS);
        walk.jump();
        Ok(walk)
    }

    /// Where the eye is now, and what it looks at.
    pub fn camera(&self) -> Camera {
        Camera::looking_at(self.eye, self.eye + self.view * self.bounds.diagonal, FIELD_OF_VIEW)
    }

    /// Walks on.
    pub fn step(&mut self) -> Step {
        let seconds = 1.0 / STEPS_PER_SECOND;
        self.time += seconds;
        self.event_left -= seconds;
        if self.event_left <= 0.0 {
            self.event_left = self.random.between(EVENTS);
            if self.random.bits().is_multiple_of(STOPS) {
                self.velocity = DVec3::ZERO;
                return Step::Stop;
            }
            self.jump();
            return Step::Jump;
        }
        self.leg_left -= seconds;
        if self.leg_left <= 0.0 || self.eye.distance(self.goal) < self.speed * INERTIA {
            self.aim(CANDIDATES);
        }
        let share = 1.0 - (-seconds / INERTIA).exp();
        let wanted = (self.goal - self.eye).normalize_or_zero() * self.speed;
        self.velocity += (wanted - self.velocity) * share;
        self.eye += self.velocity * seconds;
        self.view = self.view.lerp(self.wanted_view(), share).try_normalize().unwrap_or(self.view);
        Step::Flight
    }

    /// Starts elsewhere, at any speed.
    fn jump(&mut self) {
        self.last.clear();
        self.aim(1);
        (self.eye, self.velocity) = (self.goal, DVec3::ZERO);
        self.aim(CANDIDATES);
        self.view = self.wanted_view();
    }

    /// Chooses the next point: of so many random ones the nearest.
    fn aim(&mut self, candidates: usize) {
        let count = self.points.len();
        let mut nearest: Option<(f64, usize)> = None;
        for _ in 0..candidates {
            let index = (self.random.bits() % count as u64) as usize;
            let distance = self.points[index].position.distance_squared(self.eye);
            let is_new = !self.last.contains(&index) || count <= REMEMBERED;
            if is_new && nearest.is_none_or(|(least, _)| distance < least) {
                nearest = Some((distance, index));
            }
        }
        let index = nearest.map_or(0, |(_, index)| index);
        if self.last.len() == REMEMBERED {
            self.last.pop_front();
        }
        self.last.push_back(index);
        let SurfacePoint { position, away } = self.points[index];
        let outward = || (position - self.bounds.center).try_normalize().unwrap_or(DVec3::Z);
        let height = self.random.magnitude(HEIGHTS) * self.bounds.diagonal;
        self.below = position;
        self.goal = position + away.unwrap_or_else(outward) * height;
        self.speed = self.random.magnitude(SPEEDS) * self.bounds.diagonal;
        self.looks = self.random.between([0.05, 0.5]);
        self.leg_left = self.random.between([LONGEST_LEG / 6.0, LONGEST_LEG]);
    }

    /// Ahead and downwards, and to one side or the other.
    fn wanted_view(&self) -> DVec3 {
        let ahead = (self.goal - self.eye).normalize_or_zero();
        let down = (self.below - self.eye).normalize_or_zero();
        let forward = (ahead + down * 1.5).try_normalize().unwrap_or(self.view);
        let angle = SIDEWAYS * (TAU * self.looks * self.time).sin();
        DQuat::from_axis_angle(DVec3::Z, angle) * forward
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn a_walk_stays_near_the_surface_and_is_smooth_between_jumps() {
        let model = testing::model_of(&testing::sphere_tree(4, 1));
        let mut walk = RandomWalk::new(&model, 7).unwrap();
        let bounds = Bounds::of(&model);
        let mut counts = [0_u32; 3];
        let mut before = walk.camera();
        for _ in 0..20_000 {
            let step = walk.step();
            let camera = walk.camera();
            camera.frame().unwrap();
            assert!(camera.eye.distance(bounds.center) < 3.0 * bounds.diagonal);
            let moved = camera.eye.distance(before.eye) / bounds.diagonal;
            match step {
                Step::Flight => assert!(moved <= 1.01 * SPEEDS[1] / STEPS_PER_SECOND, "{moved}"),
                Step::Stop => assert!(moved == 0.0 && camera == before),
                Step::Jump => (),
            }
            counts[step as usize] += 1;
            before = camera;
        }
        // Something happens every 195 steps.
        let [_, jumps, stops] = counts;
        assert!((45..95).contains(&jumps) && (15..55).contains(&stops), "{counts:?}");
    }

    #[test]
    fn the_seed_decides() {
        let model = testing::model_of(&testing::grid_tree(20, 20, 1));
        let cameras = |seed: u64| {
            let mut walk = RandomWalk::new(&model, seed).unwrap();
            let step = |_| {
                walk.step();
                walk.camera()
            };
            (0..500).map(step).collect::<Vec<_>>()
        };
        assert_eq!(cameras(1), cameras(1));
        assert_ne!(cameras(1), cameras(2));
    }

    #[test]
    fn small_models_are_walked_over() {
        for tree in [testing::empty_tree(), testing::triangle_tree()] {
            let mut walk = RandomWalk::new(&testing::model_of(&tree), 3).unwrap();
            for _ in 0..2000 {
                walk.step();
                walk.camera().frame().unwrap();
            }
        }
    }
}
