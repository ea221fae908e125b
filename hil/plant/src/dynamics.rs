//! The aircraft: rigid body, air, propeller, wheels and actuators put together.

use crate::aerodynamics::{self, AirData, Surfaces};
use crate::airframe::Airframe;
use crate::atmosphere::{self, GRAVITY_MPS2};
use crate::fault::Actuation;
use crate::gear::GroundContact;
use crate::propulsion::{self, Thrust};
use crate::rigid_body::{Loads, RigidBody, RigidState, StepMean};
use crate::servo::Actuators;
use crate::wind::AirMotion;
use crate::{Controls, STEP_S};
use nalgebra::{UnitQuaternion, Vector3};

/// On the ground with the throttle closed and slower than this, m/s, somebody holds the aircraft. Left alone, a light
/// aircraft is blown off the runway before its pilot is ready.
const HELD_MPS: f64 = 0.3;
/// Throttle under which it is held.
const CLOSED_THROTTLE: f64 = 0.02;

/// An aircraft in motion, without sensors.
#[derive(Clone, Debug)]
pub(crate) struct Aircraft {
    model: Model,
    actuators: Actuators,
    state: RigidState,
    crashed: bool,
}

/// The equations, free of state.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) airframe: Airframe,
    pub(crate) body: RigidBody,
    contact: GroundContact,
    elevation_m: f64,
}

/// What is held during one step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Held {
    pub(crate) surfaces: Surfaces,
    pub(crate) throttle: f64,
    pub(crate) air: AirMotion,
    pub(crate) density: f64,
}

impl Model {
    pub(crate) fn new(airframe: &Airframe, elevation_m: f64) -> Self {
        Self {
            airframe: airframe.clone(),
            body: RigidBody::new(&airframe.mass),
            contact: GroundContact::new(&airframe.gear),
            elevation_m,
        }
    }

    /// Density at a position, kg/m³.
    pub(crate) fn density(&self, position: &Vector3<f64>) -> f64 {
        atmosphere::air(self.elevation_m - position.z).density_kgpm3
    }

    /// Motion relative to the air.
    pub(crate) fn air_data(&self, state: &RigidState, air: &AirMotion, density: f64) -> AirData {
        let velocity = state.attitude.inverse() * (state.velocity - air.velocity_ned);
        AirData::new(velocity, state.rates - air.rates_body, density)
    }

    /// Propeller at the present inflow.
    pub(crate) fn thrust(&self, air: &AirData, throttle: f64) -> Thrust {
        propulsion::thrust(&self.airframe.propulsion, throttle, air.velocity.x, air.density)
    }

    /// Everything that acts besides gravity, body axes.
    pub(crate) fn loads(&self, state: &RigidState, held: &Held) -> Loads {
        let (a, g) = (&self.airframe.aerodynamics, &self.airframe.geometry);
        let air = self.air_data(state, &held.air, held.density);
        let propeller = self.thrust(&air, held.throttle);
        let ground = self.contact.loads(state, held.surfaces.rudder_rad);
        let force = aerodynamics::force(a, g, &air, &held.surfaces)
            + Vector3::new(propeller.thrust_n, 0.0, 0.0)
            + ground.force;
        let alpha_rate = if a.pitch_alpha_rate == 0.0 { 0.0 } else { self.alpha_rate(state, &air, &force) };
        let moment = aerodynamics::moment(a, g, &air, &held.surfaces, alpha_rate)
            - Vector3::new(propeller.torque_nm, 0.0, 0.0)
            + ground.moment;
        Loads { force, moment }
    }

    /// dα/dt from the force just found, rad/s; the wind is taken as steady.
    fn alpha_rate(&self, state: &RigidState, air: &AirData, force: &Vector3<f64>) -> f64 {
        let gravity = state.attitude.inverse() * Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        let change = force / self.body.mass + gravity - state.rates.cross(&air.velocity);
        let (u, w) = (air.velocity.x, air.velocity.z);
        let square = (u * u + w * w).max(25.0);
        (u * change.z - w * change.x) / square
    }
}

impl Aircraft {
    /// An aircraft in a state, its actuators at rest in a position.
    pub(crate) fn new(model: Model, state: RigidState, controls: Controls) -> Self {
        let actuators = Actuators::new(&model.airframe, controls);
        Self { model, actuators, state, crashed: false }
    }

    /// An aircraft that has come to rest on its wheels at the origin.
    pub(crate) fn parked(model: Model, heading_rad: f64) -> Self {
        let lowest = model.airframe.gear.main_wheel_m[2].max(model.airframe.gear.third_wheel_m[2]);
        let attitude = UnitQuaternion::from_euler_angles(0.0, 0.0, heading_rad);
        let state = RigidState {
            position: Vector3::new(0.0, 0.0, -lowest),
            velocity: Vector3::zeros(),
            attitude,
            rates: Vector3::zeros(),
        };
        let mut aircraft = Self::new(model, state, Controls::default());
        aircraft.settle();
        aircraft.state.position.x = 0.0;
        aircraft.state.position.y = 0.0;
        aircraft
    }

    /// Lets the wheels take the weight: four seconds of still air, then no motion left.
    fn settle(&mut self) {
        for step in 0..1600 {
            let (state, _) = self.next(&AirMotion::default());
            // Half the motion of every tenth step is taken away, so that no bounce moves the aircraft off its place.
            let keep = if step % 10 == 0 { 0.5 } else { 1.0 };
            self.state = RigidState { velocity: state.velocity * keep, rates: state.rates * keep, ..state };
        }
        self.state.velocity = Vector3::zeros();
        self.state.rates = Vector3::zeros();
    }

    /// One step of [`STEP_S`].
    pub(crate) fn step(&mut self, controls: &Controls, air: &AirMotion, wrong: &Actuation) -> StepMean {
        self.actuators.step(controls, wrong);
        if self.crashed {
            return self.lying();
        }
        if self.is_held() {
            self.state.velocity = Vector3::zeros();
            self.state.rates = Vector3::zeros();
            return self.lying();
        }
        let (state, mean) = self.next(air);
        self.state = state;
        if self.model.contact.crash(&self.state) || !self.state.position.iter().all(|x| x.is_finite()) {
            self.crashed = true;
            self.state.velocity = Vector3::zeros();
            self.state.rates = Vector3::zeros();
        }
        mean
    }

    fn next(&self, air: &AirMotion) -> (RigidState, StepMean) {
        let held = self.held(air);
        self.model.body.step(&self.state, STEP_S, GRAVITY_MPS2, |state| self.model.loads(state, &held))
    }

    /// Whether somebody on the ground holds the aircraft.
    fn is_held(&self) -> bool {
        self.actuators.throttle() < CLOSED_THROTTLE
            && self.state.velocity.norm() < HELD_MPS
            && self.on_ground()
    }

    /// What is felt in a body that does not move.
    fn lying(&self) -> StepMean {
        let up = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
        StepMean { specific_force: self.state.attitude.inverse() * up, rates: Vector3::zeros() }
    }

    pub(crate) fn held(&self, air: &AirMotion) -> Held {
        Held {
            surfaces: self.actuators.surfaces(),
            throttle: self.actuators.throttle(),
            air: *air,
            density: self.model.density(&self.state.position),
        }
    }

    /// Specific force at this instant, body axes, m/s².
    pub(crate) fn specific_force(&self, air: &AirMotion) -> Vector3<f64> {
        if self.crashed || self.is_held() {
            return self.lying().specific_force;
        }
        self.model.loads(&self.state, &self.held(air)).force / self.model.body.mass
    }

    pub(crate) fn model(&self) -> &Model {
        &self.model
    }

    pub(crate) fn state(&self) -> &RigidState {
        &self.state
    }

    pub(crate) fn on_ground(&self) -> bool {
        self.model.contact.touches(&self.state)
    }

    pub(crate) fn crashed(&self) -> bool {
        self.crashed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_alone_keep_the_aircraft_at_rest() {
        for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
            let mut aircraft = Aircraft::parked(Model::new(&airframe, 0.0), 1.0);
            let before = aircraft.state;
            for _ in 0..8000 {
                aircraft.state = aircraft.next(&AirMotion::default()).0;
            }
            let moved = (aircraft.state.position - before.position).norm();
            assert!(moved < 1e-3, "{} moved {moved} m in 20 s", airframe.name);
            assert!(aircraft.state.attitude.angle_to(&before.attitude) < 1e-3, "{} turned", airframe.name);
            assert!(aircraft.state.velocity.norm() < 1e-5 && aircraft.state.rates.norm() < 1e-5);
        }
    }
}
