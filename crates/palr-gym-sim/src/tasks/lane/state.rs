//! What an episode remembers beside the physics, in MuJoCo's user data: so it is part of every
//! snapshot, and of nothing that an agent sees.

use crate::physics::Physics;

/// Numbers in the user data.
pub(super) const NUMBERS: usize = 6;

/// The car that drives ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LeadCar {
    /// Along the track.
    pub(super) progress_m: f64,
    pub(super) speed_mps: f64,
    pub(super) target_speed_mps: f64,
    /// Simulated time at which the target is drawn anew.
    pub(super) until_s: f64,
}

/// An episode's memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State {
    /// Where along the track the car is: tells the two arms of the crossing apart.
    pub(super) progress_m: f64,
    pub(super) lead: Option<LeadCar>,
}

impl State {
    pub(super) fn read(physics: &Physics) -> Self {
        let mut values = [0.0; NUMBERS];
        for (slot, value) in values.iter_mut().zip(physics.userdata()) {
            *slot = *value;
        }
        let [progress_m, has_lead, lead_m, speed_mps, target_speed_mps, until_s] = values;
        let lead = LeadCar { progress_m: lead_m, speed_mps, target_speed_mps, until_s };
        Self { progress_m, lead: (has_lead == 1.0).then_some(lead) }
    }

    pub(super) fn write(&self, userdata: &mut [f64]) {
        let lead = self.lead.map_or([0.0; 5], |lead| {
            [1.0, lead.progress_m, lead.speed_mps, lead.target_speed_mps, lead.until_s]
        });
        for (slot, value) in userdata.iter_mut().zip([self.progress_m].into_iter().chain(lead)) {
            *slot = value;
        }
    }
}
