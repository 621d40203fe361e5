//! Judging the nodes of the front, 64 at a time (temporary form).

use metanode::page::NormalCone;

use crate::view::{Sphere, View};

/// What decides about 64 nodes, beside their positions.
#[derive(Debug, Clone)]
pub struct Criteria {
    pub radius: [f32; 64],
    pub switch: [f32; 64],
    pub cone: [u32; 64],
}

/// A test of a view.
#[derive(Debug, Clone, Copy)]
pub struct Test {
    pub view: View,
    pub threshold: f32,
}

impl Test {
    pub fn is_exceeded(&self, sphere: &Sphere) -> bool {
        self.view.pixel_error(sphere) > self.threshold
    }

    pub fn exceeding(&self, positions: &[[f32; 4]; 64], criteria: &Criteria) -> u64 {
        let mut mask = 0;
        for lane in 0..64 {
            let [x, y, z, _] = positions[lane];
            let sphere = Sphere {
                position: [x, y, z],
                radius: criteria.radius[lane],
                switch: criteria.switch[lane],
                cone: NormalCone::from_word(criteria.cone[lane]),
            };
            let exceeds = self.view.against(self.threshold).is_exceeded(&sphere);
            mask |= u64::from(sphere.switch >= 0.0 && (exceeds || sphere.switch.is_infinite())) << lane;
        }
        mask
    }
}

impl Criteria {
    pub fn all(switch: f32) -> Self {
        Criteria { radius: [0.0; 64], switch: [switch; 64], cone: [0; 64] }
    }

    pub fn set(&mut self, place: usize, [radius, switch]: [f32; 2], cone: u32) {
        (self.radius[place], self.switch[place], self.cone[place]) = (radius, switch, cone);
    }
}
