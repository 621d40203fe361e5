//! How mouse and keys move a camera: around a pivot, sideways, nearer, and in flight.
//!
//! Nothing here knows of a window: distances on the picture come in parts of its height, time in seconds. Every movement goes in
//! proportion to how far the pivot is, so that one gets from the whole of a model to a grain of it with the same hand; and a
//! flight of two halves of a second comes to where one of a second does.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use navigator::Camera;

/// How far a drag over the whole height of the picture turns the model.
const ORBIT_TURN: f64 = PI;
/// What is left of the distance after one step of the wheel.
const WHEEL_STEP: f64 = 0.85;
/// The least angle between the direction of view and the vertical, in radians: there the picture would turn over.
const LEAST_POLAR: f64 = 0.01;
/// The nearest and the farthest that the pivot can come by zooming, in diagonals of the model.
const DISTANCES: [f64; 2] = [1e-5, 100.0];
/// The least and the most of the pivot's distance that counts for the speed of a flight, in diagonals.
const SPEED_DISTANCES: [f64; 2] = [1e-3, 2.0];
/// How much of that a second of flight makes.
const SPEED: f64 = 0.8;
/// How much faster a fast flight is.
const FAST: f64 = 5.0;

/// Where a flight goes: of each direction a part, -1 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Flight {
    /// Forwards, along the direction of view; below 0 backwards.
    pub forward: f64,
    /// To the right.
    pub right: f64,
    /// Upwards, whatever the direction of view.
    pub up: f64,
    /// Faster.
    pub fast: bool,
}

impl Flight {
    /// Whether it goes nowhere.
    pub fn is_still(&self) -> bool {
        self.forward == 0.0 && self.right == 0.0 && self.up == 0.0
    }
}

/// A camera with the point that it is moved around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controls {
    camera: Camera,
    pivot: DVec3,
    /// Of the model.
    diagonal: f64,
}

impl Controls {
    /// Takes a camera in hand, for a model with this diagonal.
    pub fn new(camera: Camera, pivot: DVec3, diagonal: f64) -> Self {
        Controls { camera, pivot, diagonal: if diagonal > 0.0 { diagonal } else { 1.0 } }
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// What it is turned around.
    pub fn pivot(&self) -> DVec3 {
        self.pivot
    }

    /// Turns around another point from now on. The picture stays.
    pub fn set_pivot(&mut self, pivot: DVec3) {
        if pivot.is_finite() {
            self.pivot = pivot;
        }
    }

    /// How far the pivot is along the direction of view; where it is not ahead, how far it is.
    pub fn distance(&self) -> f64 {
        let to_pivot = self.pivot - self.camera.eye;
        let ahead = self.camera.frame().map_or(0.0, |frame| frame.forward.dot(to_pivot));
        let distance = if ahead > 0.0 { ahead } else { to_pivot.length() };
        distance.max(self.diagonal * DISTANCES[0])
    }

    /// The direction from the eye to a place of the picture, which is in half heights from the middle, to the right and upwards.
    /// As long as makes one along the direction of view.
    pub fn ray(&self, place: [f64; 2]) -> Option<DVec3> {
        let frame = self.camera.frame().ok()?;
        let tall = self.camera.half_height();
        Some(frame.forward + frame.right * (place[0] * tall) + frame.up * (place[1] * tall))
    }

    /// Turns the model around the pivot, as a drag to the right and downwards does.
    pub fn orbit(&mut self, right: f64, down: f64) {
        self.turn(self.pivot, right * ORBIT_TURN, down * ORBIT_TURN);
    }

    /// Turns the head: what was in the middle goes to where the drag comes from.
    pub fn look_around(&mut self, right: f64, down: f64) {
        let angle = self.camera.fov_degrees.to_radians();
        self.turn(self.camera.eye, right * angle, down * angle);
    }

    /// Turns eye, target and pivot around a place: clockwise as seen from above, and the direction of view downwards.
    fn turn(&mut self, around: DVec3, clockwise: f64, downwards: f64) {
        let (Ok(frame), Some(vertical)) = (self.camera.frame(), self.camera.up.try_normalize()) else { return };
        let polar = frame.forward.angle_between(vertical);
        let downwards = (polar + downwards).clamp(LEAST_POLAR, PI - LEAST_POLAR) - polar;
        let turn = DQuat::from_axis_angle(vertical, -clockwise) * DQuat::from_axis_angle(frame.right, -downwards);
        let turned = |place: DVec3| around + turn * (place - around);
        let camera = Camera { eye: turned(self.camera.eye), target: turned(self.camera.target), ..self.camera };
        self.take(camera, turned(self.pivot));
    }

    /// Moves the model with a drag to the right and downwards: what is as far as the pivot stays under the cursor.
    pub fn pan(&mut self, right: f64, down: f64) {
        let Ok(frame) = self.camera.frame() else { return };
        let height = 2.0 * self.camera.half_height() * self.distance();
        self.shift((frame.up * down - frame.right * right) * height);
    }

    /// Goes nearer by steps of a wheel, or away with fewer than none, towards the place under the cursor that is as far as the
    /// pivot: it stays under the cursor. Its place on the picture is as for [`Controls::ray`].
    pub fn zoom(&mut self, steps: f64, cursor: [f64; 2]) {
        let Some(ray) = self.ray(cursor) else { return };
        let distance = self.distance();
        let wanted = (distance * WHEEL_STEP.powf(steps))
            .clamp(self.diagonal * DISTANCES[0], (self.diagonal * DISTANCES[1]).max(distance));
        let eye = self.camera.eye + ray * (distance - wanted);
        let target = eye + (self.camera.target - self.camera.eye) * (wanted / distance);
        self.take(Camera { eye, target, ..self.camera }, self.pivot);
    }

    /// Flies for some seconds. The pivot comes along.
    pub fn fly(&mut self, flight: Flight, seconds: f64) {
        let (Ok(frame), Some(vertical)) = (self.camera.frame(), self.camera.up.try_normalize()) else { return };
        let [least, most] = SPEED_DISTANCES.map(|distance| distance * self.diagonal);
        let speed = self.distance().clamp(least, most) * SPEED * if flight.fast { FAST } else { 1.0 };
        let direction = frame.forward * flight.forward + frame.right * flight.right + vertical * flight.up;
        self.shift(direction * (speed * seconds));
    }

    fn shift(&mut self, by: DVec3) {
        let camera = Camera { eye: self.camera.eye + by, target: self.camera.target + by, ..self.camera };
        self.take(camera, self.pivot + by);
    }

    /// Takes what came out of a movement, unless it is a camera that cannot be.
    fn take(&mut self, camera: Camera, pivot: DVec3) {
        if camera.frame().is_ok() && pivot.is_finite() {
            (self.camera, self.pivot) = (camera, pivot);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOSE: f64 = 1e-9;

    fn controls() -> Controls {
        let camera = Camera::looking_at(DVec3::new(3.0, -10.0, 4.0), DVec3::new(1.0, 2.0, 0.5), 50.0);
        Controls::new(camera, DVec3::new(1.5, 1.0, 0.0), 8.0)
    }

    /// Where a place is on the picture, as for [`Controls::ray`].
    fn on_picture(controls: &Controls, place: DVec3) -> [f64; 2] {
        let (frame, tall) = (controls.camera.frame().unwrap(), controls.camera.half_height());
        let to_place = place - controls.camera.eye;
        let depth = frame.forward.dot(to_place);
        [frame.right.dot(to_place) / depth / tall, frame.up.dot(to_place) / depth / tall]
    }

    fn assert_near(one: [f64; 2], other: [f64; 2]) {
        assert!((0..2).all(|axis| (one[axis] - other[axis]).abs() < CLOSE), "{one:?}, {other:?}");
    }

    #[test]
    fn an_orbit_keeps_the_pivot_and_its_distance() {
        let before = controls();
        let mut after = before;
        after.orbit(0.3, 0.1);
        assert_eq!(after.pivot, before.pivot);
        let distances = [before, after].map(|controls| controls.camera.eye.distance(controls.pivot));
        assert!((distances[0] - distances[1]).abs() < CLOSE);
        assert_near(on_picture(&before, before.pivot), on_picture(&after, after.pivot));
        // To the right the model turns to the right: the eye goes to the left. Downwards, one sees it more from above.
        let left = -before.camera.frame().unwrap().right;
        assert!((after.camera.eye - before.camera.eye).dot(left) > 0.0);
        assert!(after.camera.eye.z > before.camera.eye.z);
        // There and back is nowhere.
        after.orbit(0.0, -0.1);
        after.orbit(-0.3, 0.0);
        assert!((after.camera.eye - before.camera.eye).length() < CLOSE);
        // All the way round, too.
        after.orbit(2.0, 0.0);
        assert!((after.camera.eye - before.camera.eye).length() < CLOSE);
    }

    #[test]
    fn the_picture_never_turns_over() {
        for down in [10.0, -10.0] {
            let mut controls = controls();
            (0..5).for_each(|_| controls.orbit(0.1, down));
            let frame = controls.camera.frame().unwrap();
            assert!(frame.up.z > 0.0 && frame.forward.z.abs() > 0.999);
            (0..5).for_each(|_| controls.look_around(0.1, -down));
            let frame = controls.camera.frame().unwrap();
            assert!(frame.up.z > 0.0 && frame.forward.z.abs() > 0.999);
        }
    }

    #[test]
    fn whoever_looks_around_stays_where_he_is() {
        let before = controls();
        let mut after = before;
        after.look_around(0.2, -0.1);
        assert!((after.camera.eye - before.camera.eye).length() < CLOSE);
        let to_the_right = after.camera.frame().unwrap().forward.dot(before.camera.frame().unwrap().right);
        assert!(
            to_the_right > 0.0 && after.camera.frame().unwrap().forward.z > before.camera.frame().unwrap().forward.z
        );
        assert_near(on_picture(&before, before.pivot), on_picture(&after, after.pivot));
    }

    #[test]
    fn what_is_dragged_follows_the_cursor() {
        let before = controls();
        let mut after = before;
        after.pan(0.25, 0.125);
        let [x, y] = on_picture(&before, before.pivot);
        // A height is two half heights, and downwards is not upwards.
        assert_near(on_picture(&after, before.pivot), [x + 0.5, y - 0.25]);
        assert_near(on_picture(&after, after.pivot), [x, y]);
    }

    #[test]
    fn zooming_keeps_what_is_under_the_cursor() {
        let before = controls();
        let cursor = [0.4, -0.7];
        let place = before.camera.eye + before.ray(cursor).unwrap() * before.distance();
        for steps in [1.0, -2.5, 7.0] {
            let mut after = before;
            after.zoom(steps, cursor);
            assert!((after.distance() - before.distance() * WHEEL_STEP.powf(steps)).abs() < CLOSE);
            assert_near(on_picture(&after, place), cursor);
        }
        let mut one_by_one = before;
        (0..3).for_each(|_| one_by_one.zoom(1.0, [0.0; 2]));
        let mut at_once = before;
        at_once.zoom(3.0, [0.0; 2]);
        assert!((one_by_one.camera.eye - at_once.camera.eye).length() < CLOSE);
    }

    #[test]
    fn zooming_has_an_end() {
        let mut controls = controls();
        controls.zoom(1e4, [0.0; 2]);
        assert!(controls.distance() >= 8.0 * DISTANCES[0] && controls.camera.frame().is_ok());
        controls.zoom(-1e4, [0.0; 2]);
        assert!((controls.distance() - 8.0 * DISTANCES[1]).abs() < 1e-6);
        assert!(controls.camera.frame().is_ok());
    }

    #[test]
    fn a_flight_does_not_depend_on_the_frames() {
        let flight = Flight { forward: 1.0, right: -1.0, up: 0.5, fast: false };
        let mut in_one = controls();
        in_one.fly(flight, 1.0);
        let mut in_many = controls();
        (0..100).for_each(|_| in_many.fly(flight, 0.01));
        assert!((in_one.camera.eye - in_many.camera.eye).length() < CLOSE);
        assert!((in_one.pivot - in_many.pivot).length() < CLOSE);
        let frame = controls().camera.frame().unwrap();
        let way = in_one.camera.eye - controls().camera.eye;
        assert!(way.dot(frame.forward) > 0.0 && way.dot(frame.right) < 0.0);

        let mut fast = controls();
        fast.fly(Flight { fast: true, ..flight }, 0.2);
        assert!((fast.camera.eye - in_one.camera.eye).length() < CLOSE);
        // Nearer to the pivot, one flies more slowly.
        let mut near = controls();
        near.zoom(10.0, [0.0; 2]);
        let start = near.camera.eye;
        near.fly(flight, 1.0);
        assert!((near.camera.eye - start).length() < 0.3 * way.length());
    }

    #[test]
    fn nothing_makes_a_camera_that_cannot_be() {
        let mut controls = controls();
        let before = controls;
        controls.orbit(f64::NAN, 0.0);
        controls.pan(f64::INFINITY, 0.0);
        controls.zoom(f64::NAN, [0.0; 2]);
        controls.zoom(1.0, [f64::NAN; 2]);
        controls.fly(Flight { forward: 1.0, ..Flight::default() }, f64::INFINITY);
        controls.set_pivot(DVec3::NAN);
        assert_eq!(controls, before);
        // A pivot at the eye, or behind it, is no reason to stand still.
        controls.set_pivot(before.camera.eye);
        controls.pan(0.1, 0.1);
        controls.zoom(1.0, [0.1; 2]);
        controls.set_pivot(before.camera.eye * 2.0 - before.pivot);
        controls.orbit(0.1, 0.1);
        assert!(controls.camera.frame().is_ok() && controls != before);
    }
}
