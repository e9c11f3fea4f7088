//! Boids on a torus by krABMaga: each sees those within 10, about nine of them, and keeps apart, goes along and stays together.
//!
//! `flockers AGENTS STEPS` begins anew for each turn: in long runs boids gather, and see more than nine.

use krabmaga::engine::agent::Agent;
use krabmaga::engine::fields::field::Field;
use krabmaga::engine::fields::field_2d::{toroidal_distance, toroidal_transform, Field2D, Location2D};
use krabmaga::engine::location::Real2D;
use krabmaga::engine::schedule::Schedule;
use krabmaga::engine::state::State;
use peers::{given, processor, turns};
use std::any::Any;
use std::cell::Cell;
use std::fmt;
use std::hash::{Hash, Hasher};

const SIGHT: f32 = 10.0;
const ROOM: f32 = 3.0;
const SPEED: f32 = 0.7;
const NEIGHBOURS: f32 = 9.0;
const WARM: usize = 2;

#[derive(Clone, Copy)]
struct Boid {
    id: u32,
    place: Real2D,
    last: Real2D,
}

impl Hash for Boid {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.id.hash(state);
    }
}
impl PartialEq for Boid {
    fn eq(&self, other: &Boid) -> bool {
        self.id == other.id
    }
}
impl Eq for Boid {}
impl fmt::Display for Boid {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.id)
    }
}
impl Location2D<Real2D> for Boid {
    fn get_location(self) -> Real2D {
        self.place
    }
    fn set_location(&mut self, place: Real2D) {
        self.place = place;
    }
}

impl Agent for Boid {
    fn step(&mut self, state: &mut dyn State) {
        let flock = state.as_any().downcast_ref::<Flock>().unwrap();
        let (side, mut seen) = (flock.side, 0u64);
        let (mut apart, mut middle, mut along) = ((0f32, 0f32), (0f32, 0f32), (0f32, 0f32));
        for other in flock.field.get_neighbors_within_distance(self.place, SIGHT) {
            if other.id == self.id {
                continue;
            }
            seen += 1;
            let dx = toroidal_distance(self.place.x, other.place.x, side);
            let dy = toroidal_distance(self.place.y, other.place.y, side);
            let square = dx * dx + dy * dy;
            if square < ROOM * ROOM {
                let by = 1.0 / (square + 1e-6);
                apart = (apart.0 + dx * by, apart.1 + dy * by);
            }
            middle = (middle.0 - dx, middle.1 - dy);
            along = (along.0 + other.last.x, along.1 + other.last.y);
        }
        flock.seen.set(flock.seen.get() + seen);
        let share = 1.0 / (seen.max(1) as f32);
        let mut x = self.last.x + apart.0 + middle.0 * share * 0.05 + along.0 * share;
        let mut y = self.last.y + apart.1 + middle.1 * share * 0.05 + along.1 * share;
        let length = (x * x + y * y).sqrt();
        if length > 0.0 {
            (x, y) = (x / length * SPEED, y / length * SPEED);
        }
        self.last = Real2D { x, y };
        self.place = Real2D {
            x: toroidal_transform(self.place.x + x, side),
            y: toroidal_transform(self.place.y + y, side),
        };
        flock.field.set_object_location(*self, self.place);
    }
}

struct Flock {
    field: Field2D<Boid>,
    agents: u32,
    side: f32,
    seen: Cell<u64>,
}

impl State for Flock {
    fn init(&mut self, schedule: &mut Schedule) {
        let mut word = 0x9E37_79B9_7F4A_7C15u64; // xorshift64: any even spread will do
        let mut uniform = || {
            word ^= word << 13;
            word ^= word >> 7;
            word ^= word << 17;
            (word >> 40) as f32 / (1u64 << 24) as f32
        };
        for id in 0..self.agents {
            let place = Real2D { x: uniform() * self.side, y: uniform() * self.side };
            let turn = uniform() * std::f32::consts::TAU;
            let last = Real2D { x: turn.cos() * SPEED, y: turn.sin() * SPEED };
            let boid = Boid { id, place, last };
            self.field.set_object_location(boid, place);
            schedule.schedule_repeating(Box::new(boid), 0.0, 0);
        }
        self.field.lazy_update();
    }
    fn update(&mut self, _step: u64) {
        self.field.lazy_update();
    }
    fn reset(&mut self) {}
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
    fn as_state(&self) -> &dyn State {
        self
    }
    fn as_state_mut(&mut self) -> &mut dyn State {
        self
    }
}

fn main() {
    let (agents, steps) = given();
    let side = (agents as f32 * std::f32::consts::PI * SIGHT * SIGHT / NEIGHBOURS).sqrt();
    turns(|| {
        let field = Field2D::new(side, side, SIGHT / 1.5, true);
        let mut flock = Flock { field, agents: agents as u32, side, seen: Cell::new(0) };
        let mut schedule = Schedule::new();
        flock.init(&mut schedule);
        for _ in 0..WARM {
            schedule.step(&mut flock);
        }
        flock.seen.set(0);
        let begun = processor();
        for _ in 0..steps {
            schedule.step(&mut flock);
        }
        ((processor() - begun) / steps as f64, Some(flock.seen.get() as f64 / (steps * agents) as f64))
    });
}
