//! Where free seeds may be, and changes of the seeds between two steps.
//!
//! Purpose: [`Cvt::put_on_surface`] projects seeds; [`Cvt::keep_curves`] and what follows keep them from coming between two
//! neighbours of a curve. A seed that owns no surface is put beside the seed with the highest energy, where it may stay.
//! [`Cvt::edit`] moves, adds and removes seeds; [`Cvt::hold`] and [`Cvt::pin`] keep some where they are.
//! Invariant: seeds that are held stay. New places are deterministic, and never on top of another seed's new place. Nothing is
//! changed if one edit is wrong. Must not know: steps, how curves were found, backends.

use std::collections::HashSet;

use glam::DVec3;

use super::Cvt;
use super::curves::{CurveSeeds, INNER_POINTS};
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::rvd::{CellSums, RvdError, Space, Surface, check_seeds};
use crate::token::{Stopped, Token};

/// Intruders that become seeds of a curve; more of them are a curve that the seeds cannot resolve.
const MOST_ADOPTED: usize = 64;
/// Times that seeds are pushed off curves after they were put on the surface: a moved seed may intrude elsewhere.
const PUSHES: usize = 4;

impl<P: Space> Cvt<P> {
    /// Holds the first seeds, which are those of `curves`, and keeps the others clear of them in every Lloyd step.
    pub fn keep_curves(&mut self, curves: CurveSeeds, token: &Token) -> Result<(), RvdError> {
        self.hold((0..self.seeds.len()).map(|i| i < curves.len()).collect())?;
        self.curves = curves;
        self.find_sides();
        self.clear_curves(token).map(|_| ())
    }

    /// Pushes seeds off the curves. Returns how many there were.
    pub fn clear_curves(&mut self, token: &Token) -> Result<usize, RvdError> {
        if self.curves.is_empty() {
            return Ok(0);
        }
        self.download()?;
        let mut places = self.places();
        let intruders = self.intruders(token)?;
        if !intruders.is_empty() {
            self.push_out(&mut places, &intruders);
            self.move_to(&places, token)?;
            self.seeds_changed();
        }
        Ok(intruders.len())
    }

    /// Makes seeds between two neighbours on a curve that could not be pushed off seeds of that curve. Returns how many.
    pub fn adopt_intruders(&mut self, token: &Token) -> Result<usize, RvdError> {
        self.download()?;
        let mut adopted = 0;
        while adopted < MOST_ADOPTED {
            // One for each segment: another seed between the same two may be none once these have a new one between them. Seeds ascend, so
            // that none of those to come changes its number.
            let mut split = HashSet::new();
            let mut intruders = self.intruders(token)?;
            let is_own = |segment: u32| !self.curves.is_shared(self.curves.segments[segment as usize].curve);
            intruders.retain(|&(_, segment)| is_own(segment) && split.insert(segment));
            intruders.truncate(MOST_ADOPTED - adopted);
            if intruders.is_empty() {
                break;
            }
            for &(seed, segment) in &intruders {
                let place = self.curves.len();
                self.seeds.swap(place, seed as usize);
                self.held.swap(place, seed as usize);
                // Its first side; for lifted ones both are found below.
                self.seeds[place] = self.seeds[place].at(self.curves.split(segment, INNER_POINTS / 2));
                self.held[place] = true;
            }
            adopted += intruders.len();
            self.find_sides();
        }
        if adopted > 0 {
            self.seeds_changed();
        }
        Ok(adopted)
    }

    /// The curves' seeds, which are the first ones.
    pub fn curves(&self) -> &CurveSeeds {
        &self.curves
    }

    /// Moves every seed that is not held to the closest point of the surface. A stop leaves them where they were.
    pub fn project_seeds(&mut self, token: &Token) -> Result<(), RvdError> {
        self.download()?;
        let mut seeds = std::mem::take(&mut self.seeds);
        let done = self.project(&mut seeds, token);
        self.seeds = seeds;
        self.seeds_changed();
        done
    }

    /// Moves every seed that is not held to the closest point of the surface that is clear of the curves: at a sharp crease
    /// seeds lie inside, and the closest point may be between two seeds of the curve. A stop leaves them somewhere between.
    pub fn put_on_surface(&mut self, token: &Token) -> Result<(), RvdError> {
        self.project_seeds(token)?;
        for _ in 0..PUSHES {
            if self.curves.is_empty() {
                break;
            }
            let mut intruders = self.intruders(token)?;
            intruders.retain(|&(seed, _)| !is_held(&self.held, seed));
            if intruders.is_empty() {
                break;
            }
            let mut places = self.places();
            self.push_out(&mut places, &intruders);
            // Where they are on the surface says what they are there.
            self.seeds.iter_mut().zip(places).for_each(|(seed, place)| *seed = seed.at(place));
            self.project_seeds(token)?;
        }
        Ok(())
    }

    fn project(&mut self, seeds: &mut [P], token: &Token) -> Result<(), RvdError> {
        let closest = closest(&mut self.closest, &self.surface)?;
        let places: Vec<DVec3> = seeds.iter().map(|p| p.place()).collect();
        let placed = closest.project_all(&places, token)?;
        let moved = (0..).zip(seeds.iter_mut().zip(placed)).filter(|(i, _)| !is_held(&self.held, *i));
        moved.for_each(|(_, (seed, at))| *seed = self.surface.point(&at));
        Ok(())
    }

    fn lifted(&mut self, places: &[DVec3], token: &Token) -> Result<Vec<P>, RvdError> {
        Ok(lifted(&self.surface, closest(&mut self.closest, &self.surface)?, places, token)?)
    }

    /// Moves seeds to places; those that stay keep their points.
    fn move_to(&mut self, places: &[DVec3], token: &Token) -> Result<(), RvdError> {
        let moved: Vec<usize> = (0..places.len()).filter(|&i| self.seeds[i].place() != places[i]).collect();
        let at: Vec<DVec3> = moved.iter().map(|&i| places[i]).collect();
        let points = self.lifted(&at, token)?;
        moved.iter().zip(points).for_each(|(&i, point)| self.seeds[i] = point);
        Ok(())
    }

    /// Free seeds whose cells hold a part of a curve, each with the segment.
    fn intruders(&self, token: &Token) -> Result<Vec<(u32, u32)>, Stopped> {
        match &self.lifts {
            None => self.curves.intruders(&self.places(), token),
            Some(lifts) => lifts.intruders(&self.surface, &self.curves, (&self.seeds, &self.sides), token),
        }
    }

    fn push_out(&self, places: &mut [DVec3], intruders: &[(u32, u32)]) {
        let seeds = places.to_vec();
        self.curves.push_out(places, intruders, |segment| {
            let [a, b] = segment.ends.map(|e| seeds[e as usize]);
            match &self.lifts {
                None => a.distance(b),
                Some(lifts) => lifts.chord(&self.surface, [a, b]),
            }
        });
    }

    /// The sides of the curves' seeds on a lifted surface: the first is the seed, the others follow all seeds.
    fn find_sides(&mut self) {
        let Some(lifts) = &self.lifts else { return };
        self.sides.clear();
        for (seed, &place) in (0..).zip(&self.curves.seeds) {
            for (k, point) in lifts.sides(&self.surface, place).into_iter().enumerate() {
                if k == 0 {
                    self.seeds[seed as usize] = point;
                } else {
                    self.sides.push((seed, point));
                }
            }
        }
    }

    /// New places for seeds with empty cells, by the sums and the seeds that are at hand.
    pub(super) fn new_places(&mut self, token: &Token) -> Result<Vec<(u32, P)>, RvdError> {
        let empty: Vec<u32> = (0..self.seeds.len() as u32)
            .filter(|&i| self.sums.area[i as usize] <= 0.0 && !is_held(&self.held, i))
            .collect();
        let closest = closest(&mut self.closest, &self.surface)?;
        let clearance = (!self.curves.is_empty()).then(|| self.curves.clearance(STAYS));
        let may = |p| clearance.as_ref().is_none_or(|clearance| clearance.holds(p));
        Ok(place(&empty, &self.sums, &self.seeds, (&*self.surface, closest), may, token)?)
    }

    /// Which seeds never move, one entry a seed.
    pub fn hold(&mut self, held: Vec<bool>) -> Result<(), RvdError> {
        if held.len() != self.seeds.len() {
            return Err(RvdError::Internal(format!("{} marks for {} seeds", held.len(), self.seeds.len())));
        }
        self.download()?;
        self.held = held;
        self.seeds_changed();
        Ok(())
    }

    /// Puts seeds at places (unit frame), where they stay, and adds and holds new ones within the room. Returns how many.
    pub fn pin(&mut self, pins: &[(u32, DVec3)], new: &[DVec3]) -> Result<usize, RvdError> {
        self.download()?;
        self.held.resize(self.seeds.len(), false);
        let places: Vec<DVec3> = pins.iter().map(|pin| pin.1).chain(new.iter().copied()).collect();
        let points = self.lifted(&places, &Token::default())?;
        for (&(seed, _), &point) in pins.iter().zip(&points) {
            *seed_at(&mut self.seeds, seed)? = point;
            self.held[seed as usize] = true;
        }
        let room = self.options.max_seeds - self.seeds.len().min(self.options.max_seeds);
        let added = new.len().min(room);
        self.seeds.extend(&points[pins.len()..][..added]);
        self.held.resize(self.seeds.len(), true);
        self.seeds_changed();
        Ok(added)
    }
}

impl Cvt {
    /// Applies edits in order; nothing is changed if one of them is wrong: `TooManySeeds` beyond the room reserved, `NonFiniteSeed`, `NoSeeds` if none would be left, `NoSuchSeed`.
    pub fn edit(&mut self, edits: &[SeedEdit]) -> Result<(), RvdError> {
        self.download()?;
        let frame = self.surface.frame();
        let mut seeds = self.seeds.clone();
        let mut held = self.held.clone();
        held.resize(seeds.len(), false);
        for edit in edits {
            match *edit {
                SeedEdit::Move { index, to } => *seed_at(&mut seeds, index)? = frame.to_unit(to),
                SeedEdit::Add { at } => {
                    if seeds.len() == self.options.max_seeds {
                        return Err(RvdError::TooManySeeds { given: seeds.len() + 1, limit: self.options.max_seeds });
                    }
                    seeds.push(frame.to_unit(at));
                    held.push(false);
                }
                SeedEdit::Remove { index } => {
                    seed_at(&mut seeds, index)?;
                    seeds.swap_remove(index as usize);
                    held.swap_remove(index as usize);
                }
            }
        }
        check_seeds(&seeds, self.options.max_seeds)?;
        self.seeds = seeds;
        if held.contains(&true) {
            self.held = held;
        }
        self.seeds_changed();
        Ok(())
    }
}

/// Places as points, with what the surface has beside the place where it is nearest.
pub(crate) fn lifted<P: Space>(
    surface: &Surface<P>,
    closest: &ClosestPoint,
    places: &[DVec3],
    token: &Token,
) -> Result<Vec<P>, Stopped> {
    if P::IS_PLACE {
        return Ok(places.iter().map(|&place| P::ZERO.at(place)).collect());
    }
    let found = closest.project_all(places, token)?;
    Ok(found.iter().zip(places).map(|(at, &place)| surface.point(at).at(place)).collect())
}

/// Made on first use.
pub(super) fn closest<'a, P: Space>(
    slot: &'a mut Option<ClosestPoint>,
    surface: &Surface<P>,
) -> Result<&'a ClosestPoint, RvdError> {
    match slot {
        Some(tree) => Ok(tree),
        None => Ok(slot.insert(surface.closest_points(&Token::default())?)),
    }
}

/// A seed that is farther from a curve than this share of the spacing of the curve's seeds is not pushed off it.
const STAYS: f64 = 0.75;

/// New places for the seeds `empty`, each in another cell, by falling energy, and where `may` lets a seed stay as long as
/// there are such; if there are more empty cells than full ones, several share a cell on smaller and smaller circles.
fn place<P: Space>(
    empty: &[u32],
    sums: &CellSums<P>,
    seeds: &[P],
    (surface, closest): (&Surface<P>, &ClosestPoint),
    may: impl Fn(DVec3) -> bool,
    token: &Token,
) -> Result<Vec<(u32, P)>, Stopped> {
    let mut hosts: Vec<usize> = (0..seeds.len()).filter(|&i| sums.area[i] > 0.0).collect();
    hosts.sort_by(|&a, &b| sums.energy[b].total_cmp(&sums.energy[a]).then(a.cmp(&b)));
    let mut places = Vec::with_capacity(empty.len());
    if hosts.is_empty() {
        return Ok(places);
    }
    // Where hosts are, and a tangent there. All at once: one search may look at all facets that lie on one another.
    let footing = |hosts: &[usize]| -> Result<Vec<(usize, DVec3, DVec3)>, Stopped> {
        let at: Vec<DVec3> = hosts.iter().map(|&host| seeds[host].place()).collect();
        let of = |(&host, centre): (&usize, SurfacePoint)| {
            let [a, b, c] = surface.corners(centre.facet).map(P::place);
            // The longest edge is a tangent that even a sliver has.
            let tangent = [b - a, c - b, a - c]
                .into_iter()
                .max_by(|x, y| x.length_squared().total_cmp(&y.length_squared()))
                .unwrap_or(DVec3::X)
                .normalize_or(DVec3::X);
            (host, centre.position, tangent)
        };
        Ok(hosts.iter().zip(closest.project_all(&at, token)?).map(of).collect())
    };
    let beside = |&(host, centre, tangent): &(usize, DVec3, DVec3), round: usize| {
        let radius = 0.5 * (sums.area[host] / std::f64::consts::PI).sqrt() / (1 + round / 2) as f64;
        let way = if round.is_multiple_of(2) { radius } else { -radius };
        centre + way * tangent
    };
    let on_surface = |points: Vec<DVec3>| -> Result<Vec<P>, Stopped> {
        Ok(closest.project_all(&points, token)?.iter().map(|at| surface.point(at)).collect())
    };
    // A place where no seed stays would leave its cell empty again, step after step.
    let mut rest = &hosts[..];
    while places.len() < empty.len() && !rest.is_empty() {
        let (some, after) = rest.split_at(rest.len().min(empty.len() - places.len()));
        let tried = on_surface(footing(some)?.iter().map(|host| beside(host, 0)).collect())?;
        let left = &empty[places.len()..];
        places.extend(left.iter().copied().zip(tried.into_iter().filter(|p| may(p.place()))));
        rest = after;
    }
    let left = &empty[places.len()..];
    if left.is_empty() {
        return Ok(places);
    }
    let feet = footing(&hosts[..hosts.len().min(left.len())])?;
    let again = (0..left.len()).map(|k| beside(&feet[k % hosts.len()], 1 + k / hosts.len())).collect();
    places.extend(left.iter().copied().zip(on_surface(again)?));
    Ok(places)
}

/// A change of the seeds between two steps. Positions in the caller's coordinates.
#[derive(Clone, Debug, PartialEq)]
pub enum SeedEdit {
    /// Seed `index` goes to `to`.
    Move {
        /// Which seed.
        index: u32,
        /// Where it goes.
        to: DVec3,
    },
    /// A new seed, with the next index.
    Add {
        /// Where it is.
        at: DVec3,
    },
    /// Seed `index` goes away; the last seed takes its index.
    Remove {
        /// Which seed.
        index: u32,
    },
}

fn is_held(held: &[bool], seed: u32) -> bool {
    held.get(seed as usize).is_some_and(|&held| held)
}

fn seed_at<P>(seeds: &mut [P], index: u32) -> Result<&mut P, RvdError> {
    let (seed, count) = (index as usize, seeds.len());
    seeds.get_mut(seed).ok_or(RvdError::NoSuchSeed { seed, seeds: count })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn places_are_apart_and_where_seeds_may_stay() {
        let mesh = Shape::Torus.build(2000);
        let surface = Surface::new(&mesh, None).unwrap();
        let mut tree = None;
        let closest = closest(&mut tree, &surface).unwrap();
        let seeds: Vec<DVec3> = (0..40).map(|k| surface.centroid(k * 47)).collect();
        let mut sums = CellSums::default();
        sums.reset(40);
        for i in 0..30 {
            (sums.area[i], sums.energy[i]) = (0.01, 30.0 - i as f64);
        }
        let empty: Vec<u32> = (30..40).collect();
        let apart = |places: &[(u32, DVec3)]| {
            let all = |i: usize| places[..i].iter().all(|(_, p)| p.distance(places[i].1) > 1e-4);
            (0..places.len()).all(all)
        };
        let token = Token::default();
        let anywhere = place(&empty, &sums, &seeds, (&surface, closest), |_| true, &token).unwrap();
        // The one with the highest energy has the first.
        assert!(anywhere[0].1.distance(seeds[0]) < 0.1 && apart(&anywhere));
        assert_eq!(anywhere.iter().map(|(seed, _)| *seed).collect::<Vec<_>>(), empty);
        let right = place(&empty, &sums, &seeds, (&surface, closest), |p| p.x > 0.0, &token).unwrap();
        assert!(right.iter().all(|(_, p)| p.x > 0.0) && apart(&right) && right.len() == 10);
        // Where none may stay they are placed all the same.
        let nowhere = place(&empty, &sums, &seeds, (&surface, closest), |_| false, &token).unwrap();
        assert!(apart(&nowhere) && nowhere.len() == 10);
        token.cancel();
        assert!(place(&empty, &sums, &seeds, (&surface, closest), |_| true, &token).is_err());
    }
}
