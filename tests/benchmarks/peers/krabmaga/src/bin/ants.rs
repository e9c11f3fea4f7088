//! Foraging ants on a grid by krABMaga, with the sizes and numbers of its published example `antsforaging` (krABMaga/examples):
//! 200 x 200 cells, two pheromones, an oblong obstacle on either side of the middle, all ants at the nest at first. The rules are
//! those of value iteration by scent (L. Panait, S. Luke, A pheromone-based utility model for collaborative foraging, AAMAS 2004).
//!
//! `ants AGENTS STEPS` runs on from turn to turn, after WARM steps that are not counted.

use krabmaga::engine::agent::Agent;
use krabmaga::engine::fields::field::Field;
use krabmaga::engine::fields::grid_option::GridOption;
use krabmaga::engine::fields::sparse_number_grid_2d::SparseNumberGrid2D;
use krabmaga::engine::fields::sparse_object_grid_2d::SparseGrid2D;
use krabmaga::engine::location::Int2D;
use krabmaga::engine::schedule::Schedule;
use krabmaga::engine::state::State;
use krabmaga::rand::{self, Rng};
use peers::{given, processor, turns};
use std::any::Any;
use std::fmt;
use std::hash::{Hash, Hasher};

const SIDE: i32 = 200;
const NEST: (i32, i32) = (175, 175);
const FOOD: (i32, i32) = (25, 25);
const OBSTACLES: [(f32, f32); 2] = [(100.0, 145.0), (90.0, 55.0)];
const NARROW: f32 = 0.407;
const KEPT: f32 = 0.999; // of a pheromone, from step to step
const LEAST: f32 = 1e-14;
const REWARD: f32 = 1.0;
const CUT: f32 = 0.9; // of a neighbouring cell's pheromone
const STRAIGHT_ON: f64 = 0.8;
const ASTRAY: f64 = 0.1;
const WARM: usize = 100;

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Thing {
    Nest,
    Food,
    Obstacle,
}

impl fmt::Display for Thing {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", *self as u8)
    }
}

#[derive(Clone, Copy)]
struct Ant {
    id: u32,
    at: Int2D,
    before: Option<Int2D>,
    laden: bool,
    reward: f32,
}

impl Hash for Ant {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.id.hash(state);
    }
}
impl PartialEq for Ant {
    fn eq(&self, other: &Ant) -> bool {
        self.id == other.id
    }
}
impl Eq for Ant {}
impl fmt::Display for Ant {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.id)
    }
}

fn inside(cell: &Int2D) -> bool {
    (0..SIDE).contains(&cell.x) && (0..SIDE).contains(&cell.y)
}

/// The cells around one that are on the grid, with whether each is a diagonal step away.
fn around(at: Int2D) -> impl Iterator<Item = (Int2D, bool)> {
    let steps = (-1..2).flat_map(|x| (-1..2).map(move |y| (x, y))).filter(|step| *step != (0, 0));
    let cells = steps.map(move |(x, y)| (Int2D { x: at.x + x, y: at.y + y }, x * y != 0));
    cells.filter(|(cell, _)| inside(cell))
}

impl Ant {
    fn lay(&mut self, world: &World) {
        let scent = if self.laden { &world.to_food } else { &world.to_nest };
        let own = scent.get_value(&self.at).unwrap_or(0.0);
        let mut most = own.max(own * CUT + self.reward);
        for (cell, diagonal) in around(self.at) {
            let kept = if diagonal { world.diagonal } else { CUT };
            most = most.max(scent.get_value(&cell).unwrap_or(0.0) * kept + self.reward);
        }
        scent.set_value_location(most, &self.at);
        self.reward = 0.0;
    }

    fn go(&mut self, world: &World) {
        let mut rng = rand::rng();
        let scent = if self.laden { &world.to_nest } else { &world.to_food };
        let (mut most, mut next, mut alike) = (-1.0, self.at, 2);
        for (cell, _) in around(self.at).filter(|(cell, _)| world.open(cell)) {
            let here = scent.get_value(&cell).unwrap_or(0.0);
            if here > most {
                alike = 2;
            }
            if here > most || (here == most && rng.random_bool(1.0 / alike as f64)) {
                (most, next) = (here, cell);
            }
            alike += 1;
        }
        let mut perhaps = |cell: Int2D| {
            if inside(&cell) && world.open(&cell) {
                next = cell;
            }
        };
        match self.before {
            Some(before) if most == 0.0 => {
                if rng.random_bool(STRAIGHT_ON) {
                    perhaps(Int2D { x: 2 * self.at.x - before.x, y: 2 * self.at.y - before.y });
                }
            }
            _ if rng.random_bool(ASTRAY) => {
                let (x, y) = (rng.random_range(-1..2), rng.random_range(-1..2));
                if (x, y) != (0, 0) {
                    perhaps(Int2D { x: self.at.x + x, y: self.at.y + y });
                }
            }
            _ => {}
        }
        self.before = Some(self.at);
        self.at = next;
        world.ants.set_object_location(*self, &next);
        let reached = if self.laden { Thing::Nest } else { Thing::Food };
        if world.things.get_objects(&next).is_some_and(|found| found[0] == reached) {
            self.reward = REWARD;
            self.laden = !self.laden;
        }
    }
}

impl Agent for Ant {
    fn step(&mut self, state: &mut dyn State) {
        let world = state.as_any().downcast_ref::<World>().unwrap();
        self.lay(world);
        self.go(world);
    }
}

struct World {
    ants: SparseGrid2D<Ant>,
    things: SparseGrid2D<Thing>,
    to_food: SparseNumberGrid2D<f32>,
    to_nest: SparseNumberGrid2D<f32>,
    agents: u32,
    diagonal: f32,
}

impl World {
    fn new(agents: u32) -> World {
        World {
            ants: SparseGrid2D::new(SIDE, SIDE),
            things: SparseGrid2D::new(SIDE, SIDE),
            to_food: SparseNumberGrid2D::new(SIDE, SIDE),
            to_nest: SparseNumberGrid2D::new(SIDE, SIDE),
            agents,
            diagonal: CUT.powf(2f32.sqrt()),
        }
    }

    fn open(&self, cell: &Int2D) -> bool {
        !self.things.get_objects(cell).is_some_and(|found| found[0] == Thing::Obstacle)
    }
}

/// Whether a cell is part of the obstacle about a place: an ellipse 6 by 32 wide before it is narrowed, turned by half a right angle.
fn blocked(x: i32, y: i32, about: (f32, f32)) -> bool {
    let (dx, dy) = ((x as f32 - about.0) * NARROW, (y as f32 - about.1) * NARROW);
    (dx + dy).powi(2) / 36.0 + (dx - dy).powi(2) / 1024.0 <= 1.0
}

impl State for World {
    fn init(&mut self, schedule: &mut Schedule) {
        for x in 0..SIDE {
            for y in 0..SIDE {
                if OBSTACLES.iter().any(|about| blocked(x, y, *about)) {
                    self.things.set_object_location(Thing::Obstacle, &Int2D { x, y });
                }
            }
        }
        self.things.set_object_location(Thing::Food, &Int2D { x: FOOD.0, y: FOOD.1 });
        self.things.set_object_location(Thing::Nest, &Int2D { x: NEST.0, y: NEST.1 });
        self.things.update();
        for id in 0..self.agents {
            let ant = Ant { id, at: Int2D { x: NEST.0, y: NEST.1 }, before: None, laden: false, reward: REWARD };
            self.ants.set_object_location(ant, &ant.at);
            schedule.schedule_repeating(Box::new(ant), 0.0, 0);
        }
    }
    fn update(&mut self, _step: u64) {
        self.ants.lazy_update();
        for scent in [&mut self.to_food, &mut self.to_nest] {
            scent.update();
            let fade = |value: &f32| if value * KEPT < LEAST { 0.0 } else { value * KEPT };
            scent.apply_to_all_values(fade, GridOption::READ);
        }
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
    let (mut world, mut schedule) = (World::new(agents as u32), Schedule::new());
    world.init(&mut schedule);
    for _ in 0..WARM {
        schedule.step(&mut world);
    }
    turns(|| {
        let begun = processor();
        for _ in 0..steps {
            schedule.step(&mut world);
        }
        ((processor() - begun) / steps as f64, None)
    });
}
