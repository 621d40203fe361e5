//! Where the camera will probably be in some frames: what the paper leaves to future work, "predicting the path of the
//! viewer", by position, speed and acceleration of the last frames.
//!
//! A motion that goes on as it was: with the positions of the last three frames, p0 the last of them, the speed is
//! v = p0 - p1 and the acceleration a = p0 - 2 p1 + p2, and in n frames the position is p0 + n v + n (n + 1) / 2 a. The eye
//! moves like this, and so does the point looked at, as seen from the eye. Accelerations are noise for the most part, and over many
//! frames they count for much: so the way they lead is cut off at that of the speed. After a jump - one much longer
//! than the step before it - nothing is known but where the camera is.
//!
//! What is wished first is what is needed soonest. A node's error is known for now and for the time of the prediction; where
//! it passes the threshold in between, it does so the sooner, the larger the part of its growth that is beyond the
//! threshold (see [`priority`]). Those that come near the threshold only are wished less than all those.
//!
//! What it is worth, on flights of 400 frames at 60 a second, two cores shared with others, so that a run differs from the next
//! by as much again where little is missed: misses, of all requests, and bytes read, by the rule before (one thread; children of
//! pages of which nine of ten splits are applied), with several threads and reserved place holders (see [`pool`](crate::pool)) but
//! no prefetching, and with both.
//!
//! | model, memory | before | no prefetching | prefetching |
//! |---|---|---|---|
//! | 16 M triangles, 128 MB | 2.8 %, 47 MB | 1.2 %, 46 MB | 0.9 %, 50 MB |
//! | srtm, 48 MB | 1.4 %, 6.3 MB | 0.7 %, 5.7 MB | 0.7 %, 8.9 MB |
//! | dragon, 16 MB | 9.1 %, 7.2 MB | 2.1 to 2.3 %, 6.0 MB | 1.5 to 2.5 %, 7.7 MB |
//! | mni152, 16 MB | 6.2 %, 7.8 MB | 3.5 %, 6.2 MB | 1.4 to 6.5 %, 9.1 MB |
//! | 16 M triangles, 16 MB | 7.6 %, 19 MB | 10.2 %, 16.5 MB | 7.5 to 9.4 %, 22 MB |
//!
//! So most of it is done by the threads and the reserve; prefetching takes away a quarter of the misses where there is memory
//! for it, and nothing for certain where there is little. Of the pages that are needed about half are still asked for urgently.

use glam::DVec3;

use crate::camera::Camera;

/// How much longer than the step before it a step has to be for a jump.
const JUMP: f64 = 8.0;
/// The angle of a turn within one frame that is a jump, by its cosine.
const TURN: f64 = 0.7;

/// The largest priority: of what is needed now.
const NEEDED_NOW: f32 = 100.0;

/// How strongly a page is wished for a node whose error, in pixels, is `now`, and will be `then`: above 1 where it passes the
/// threshold until then, and the more, the sooner; else its error then over the threshold.
pub fn priority(now: f32, then: f32, threshold: f32) -> f32 {
    if now >= threshold {
        NEEDED_NOW
    } else if then > threshold {
        ((then - now) / (threshold - now)).clamp(1.0, NEEDED_NOW)
    } else {
        then / threshold
    }
}

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
    fn what_is_needed_sooner_is_wished_more() {
        // Half way to the time of the prediction, and a quarter.
        assert_eq!((priority(0.0, 2.0, 1.0), priority(0.0, 4.0, 1.0)), (2.0, 4.0));
        assert!(priority(1.8, 2.2, 2.0) > priority(1.0, 2.5, 2.0));
        assert_eq!((priority(0.5, 0.8, 1.0), priority(1.0, 1.0, 1.0)), (0.8, NEEDED_NOW));
        for (now, then) in [(0.0, 0.1), (0.1, 0.0), (0.999, 1000.0), (0.0, 0.0)] {
            for threshold in [0.0, 1.0] {
                assert!((0.0..=NEEDED_NOW).contains(&priority(now, then, threshold)), "{now} {then} {threshold}");
            }
        }
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
