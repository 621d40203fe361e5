//! Where the camera will probably be in some frames: what the paper leaves to future work, "predicting the path of the
//! viewer", by position, speed and acceleration of the last frames.
//!
//! A motion that goes on as it was: with the positions of the last three frames, p0 the last of them, the speed is
//! v = p0 - p1 and the acceleration a = p0 - 2 p1 + p2, and in n frames the position is p0 + n v + n (n + 1) / 2 a. The eye
//! moves like this, and so does the point looked at, as seen from the eye. Accelerations are noise for the most part, and over many
//! frames they count for much: so the way they lead is cut off at that of the speed. After a jump - one much longer
//! than the step before it - nothing is known but where the camera is.

use glam::DVec3;

use crate::camera::Camera;

/// How much longer than the step before it a step has to be for a jump.
const JUMP: f64 = 8.0;
/// The angle of a turn within one frame that is a jump, by its cosine.
const TURN: f64 = 0.7;

/// The cameras of the last frames.
#[derive(Debug, Clone, Default)]
pub struct Predictor {
    /// The last one first.
    cameras: [Option<Camera>; 3],
}

impl Predictor {
    /// The camera of the next frame.
    pub fn add(&mut self, camera: &Camera) {
        if let [Some(last), before, _] = self.cameras
            && is_jump(camera, &last, before.as_ref())
        {
            self.cameras = [None; 3];
        }
        self.cameras.rotate_right(1);
        self.cameras[0] = Some(*camera);
    }

    /// The camera in so many frames; `None` where there is none as yet.
    pub fn ahead(&self, frames: f64) -> Option<Camera> {
        let [last, before, first] = self.cameras;
        let last = last?;
        let Some(before) = before else { return Some(last) };
        let first = first.unwrap_or(Camera { eye: before.eye * 2.0 - last.eye, ..before });
        let gaze = |camera: &Camera| (camera.target - camera.eye).normalize_or_zero();
        let eye = extrapolate([last.eye, before.eye, first.eye], frames);
        let gazes = match self.cameras[2] {
            Some(_) => [gaze(&last), gaze(&before), gaze(&first)],
            None => [gaze(&last), gaze(&before), gaze(&before) * 2.0 - gaze(&last)],
        };
        let direction = extrapolate(gazes, frames).normalize_or(gazes[0]);
        let target = eye + direction * (last.target - last.eye).length();
        let ahead = Camera { eye, target, ..last };
        // Such as one that would look straight up.
        Some(if ahead.frame().is_ok() { ahead } else { last })
    }
}

/// Whether nothing can be learned for the camera from those before it.
fn is_jump(camera: &Camera, last: &Camera, before: Option<&Camera>) -> bool {
    let gaze = |camera: &Camera| (camera.target - camera.eye).normalize_or_zero();
    let step = camera.eye.distance(last.eye);
    let is_far = match before.map(|before| last.eye.distance(before.eye)) {
        // From a standstill any step may be the first of a motion, but not one as long as the view.
        Some(0.0) | None => step > (last.target - last.eye).length(),
        Some(usual) => step > JUMP * usual && step > 0.05 * (last.target - last.eye).length(),
    };
    is_far || gaze(camera).dot(gaze(last)) < TURN
}

/// Where what was at these three places, the last one first, will be in so many frames.
fn extrapolate([last, before, first]: [DVec3; 3], frames: f64) -> DVec3 {
    let (speed, acceleration) = (last - before, last - before * 2.0 + first);
    let way = speed * frames;
    let bend = (acceleration * (frames * (frames + 1.0) / 2.0)).clamp_length_max(way.length());
    last + way + bend
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(eye: DVec3, gaze: DVec3) -> Camera {
        Camera { eye, target: eye + gaze, up: DVec3::Z, fov_degrees: 60.0 }
    }

    fn predict(cameras: impl IntoIterator<Item = Camera>, frames: f64) -> Camera {
        let mut predictor = Predictor::default();
        assert_eq!(predictor.ahead(frames), None);
        cameras.into_iter().for_each(|camera| predictor.add(&camera));
        predictor.ahead(frames).unwrap()
    }

    #[test]
    fn a_motion_goes_on_as_it_was() {
        // With constant acceleration, exactly.
        let at = |time: f64| camera(DVec3::new(10.0 * time, 0.5 * time * time, 3.0), DVec3::new(100.0, 0.0, -20.0));
        let ahead = predict((0..5).map(|frame| at(f64::from(frame))), 8.0);
        assert!(ahead.eye.distance(at(12.0).eye) < 1e-9, "{ahead:?}");
        assert!((ahead.target - ahead.eye).distance(DVec3::new(100.0, 0.0, -20.0)) < 1e-9);
        // After two frames by their speed alone.
        let ahead = predict([at(0.0), at(1.0)], 4.0);
        assert!(ahead.eye.distance(DVec3::new(50.0, 2.5, 3.0)) < 1e-9, "{ahead:?}");
        let only = at(3.0);
        assert_eq!(predict([only], 4.0), only);
    }

    #[test]
    fn a_turn_goes_on_as_it_was() {
        let at = |angle: f64| camera(DVec3::ZERO, DVec3::new(angle.cos(), angle.sin(), 0.0) * 7.0);
        let ahead = predict((0..4).map(|frame| at(0.02 * f64::from(frame))), 10.0);
        let expected = at(0.26);
        assert!(ahead.target.distance(expected.target) < 0.2, "{ahead:?}");
        assert!(((ahead.target - ahead.eye).length() - 7.0).abs() < 1e-9);
    }

    #[test]
    fn a_standing_camera_stays() {
        let still = camera(DVec3::new(1.0, 2.0, 3.0), DVec3::X);
        let ahead = predict([still; 4], 20.0);
        assert!(ahead.eye.distance(still.eye) < 1e-12 && ahead.target.distance(still.target) < 1e-12);
    }

    #[test]
    fn after_a_jump_nothing_is_known() {
        let at = |x: f64| camera(DVec3::new(x, 0.0, 0.0), DVec3::X * 10.0);
        let far = at(1000.0);
        assert_eq!(predict([at(0.0), at(1.0), at(2.0), far], 5.0), far);
        let turned = camera(DVec3::new(3.0, 0.0, 0.0), -DVec3::X);
        assert_eq!(predict([at(0.0), at(1.0), at(2.0), turned], 5.0), turned);
        // But it is, from the next frame on.
        assert!(predict([at(0.0), far, at(1001.0)], 5.0).eye.distance(at(1006.0).eye) < 1e-9);
    }

    #[test]
    fn noise_does_not_lead_far() {
        let at = |x: f64| camera(DVec3::new(x, 0.0, 0.0), DVec3::X * 10.0);
        let ahead = predict([at(0.0), at(1.0), at(1.5)], 100.0);
        assert!(ahead.eye.distance(at(1.5).eye) < 101.0, "{ahead:?}");
        // Straight up cannot be looked.
        let camera_at = |z: f64| camera(DVec3::ZERO, DVec3::new(0.02 * (1.0 - z), 0.0, z));
        let ahead = predict([camera_at(0.8), camera_at(0.9), camera_at(1.0)], 1.0);
        assert!(ahead.frame().is_ok());
    }
}
