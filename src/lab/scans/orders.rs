//! The queue's orders: added, moved, removed, and taken up again after a failure.

use serde::{Deserialize, Serialize};

use super::plans::check_texts;
use super::recipes::Recipe;
use crate::lab::definitions::{NameOrId, find};
use crate::lab::request_checks::invalid;
use crate::lab::tasks::to_the_end;
use crate::lab::{Lab, LabError};
use crate::store::definitions::DefinitionKind;
use crate::store::queue::{NewOrder, OrderChange, OrderState, QueueOrder};
use crate::store::samples::{NOTE_LENGTH_MAX, NewSample};
use crate::wording::counted;

/// Most orders of one request.
pub const ORDERS_MAX: usize = 1000;
/// Most orders that wait.
const WAITING_MAX: usize = 10_000;

/// An order to add to the queue: a part, its recipe, and what it is for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OrderRequest {
    /// Number of the part.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub sample_id: Option<i64>,
    /// Name of the part in place of its number. A name of several parts is refused; a new name adds a part with the material
    /// of the recipe.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub part: Option<String>,
    /// The recipe, by name or number. Its newest version at the start of the scan counts.
    pub recipe: NameOrId,
    /// The specification, by name or number.
    #[serde(default)]
    pub specification: Option<NameOrId>,
    /// Lot of the part, at most 200 characters.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub lot: Option<String>,
    /// Number of the part or order in another system, at most 200 characters. No other order of the queue may have it.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub external_id: Option<String>,
    /// The person at the rig, at most 200 characters.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub operator_name: Option<String>,
    /// Free text, at most 4000 characters.
    #[serde(default)]
    #[schema(max_length = 4000)]
    pub note: Option<String>,
}

/// The sample of an order: known, or to be added.
enum Part {
    Known(i64),
    New(NewSample),
}

impl Lab {
    /// Adds orders at the end of the queue: all of them or none.
    ///
    /// # Errors
    /// [`LabError::Invalid`] with the place of the wrong order, an external id that another order has, or a store error.
    pub async fn add_orders(&self, orders: &[OrderRequest]) -> Result<Vec<QueueOrder>, LabError> {
        let (lab, orders) = (self.clone(), orders.to_vec());
        // New samples and their orders belong together, also where the client disconnects.
        to_the_end(async move { lab.check_and_add(&orders).await }).await
    }

    async fn check_and_add(&self, orders: &[OrderRequest]) -> Result<Vec<QueueOrder>, LabError> {
        if orders.is_empty() || orders.len() > ORDERS_MAX {
            return Err(invalid(
                "orders",
                format!("expected 1 to {ORDERS_MAX} orders, got {}", orders.len()),
            ));
        }
        let waiting = self.waiting_orders().await?;
        if waiting + orders.len() > WAITING_MAX {
            return Err(invalid(
                "orders",
                format!("{waiting} orders wait already; at most {WAITING_MAX} can wait"),
            ));
        }
        let mut checked = Vec::with_capacity(orders.len());
        for (place, order) in orders.iter().enumerate() {
            let order = self.check_order(order).await;
            checked.push(order.map_err(|error| at_place(place, error))?);
        }
        for (place, (_, order)) in checked.iter().enumerate() {
            let Some(external_id) = &order.external_id else {
                continue;
            };
            let before = checked[..place].iter();
            let same = before
                .map(|(_, o)| &o.external_id)
                .position(|id| id.as_ref() == Some(external_id));
            if let Some(same) = same {
                return Err(invalid(
                    format!("orders[{place}].external_id"),
                    format!("`{external_id}` is the external id of orders[{same}], too"),
                ));
            }
            self.store().check_external_id(external_id, place).await?;
        }
        // The same new part may have several orders.
        let mut added: Vec<(String, i64)> = Vec::new();
        let mut new = Vec::with_capacity(checked.len());
        for (part, order) in checked {
            let sample_id = match part {
                Part::Known(id) => id,
                Part::New(sample) => {
                    let known = added.iter().find(|(name, _)| *name == sample.name);
                    match known {
                        Some((_, id)) => *id,
                        None => {
                            let id = self.add_sample(&sample).await?.id;
                            added.push((sample.name, id));
                            id
                        }
                    }
                }
            };
            new.push(NewOrder { sample_id, ..order });
        }
        let added = self.store().add_orders(&new, &self.who).await?;
        let words = match &added[..] {
            [one] => format!("order {} added: {}", one.id, one.sample_name),
            all => format!("{} added", counted(all.len(), "order")),
        };
        self.record_order(words, None).await;
        Ok(added)
    }

    async fn check_order(&self, order: &OrderRequest) -> Result<(Part, NewOrder), LabError> {
        check_texts([
            ("lot", &order.lot),
            ("external_id", &order.external_id),
            ("operator_name", &order.operator_name),
        ])?;
        let note = order.note.as_deref().unwrap_or_default();
        if note.chars().count() > NOTE_LENGTH_MAX {
            let problem = format!("must have at most {NOTE_LENGTH_MAX} characters");
            return Err(invalid("note", problem));
        }
        let store = self.store();
        let recipe = find(store, DefinitionKind::Recipe, &order.recipe, "recipe").await?;
        let specification_id = match &order.specification {
            Some(wanted) => {
                let kind = DefinitionKind::Specification;
                Some(find(store, kind, wanted, "specification").await?.id)
            }
            None => None,
        };
        let part = match (order.sample_id, &order.part) {
            (Some(id), None) => Part::Known(store.sample(id).await?.id),
            (None, Some(name)) => match store.sample_named(name).await? {
                Err(several) => {
                    let problem = format!("{several}; give sample_id (`--part-id`) instead");
                    return Err(invalid("part", problem));
                }
                Ok(Some(sample)) => Part::Known(sample.id),
                Ok(None) => Part::New(new_part(name, &Recipe::of_content(&recipe.content)?)?),
            },
            (None, None) => return Err(invalid("part", "is missing: give its name, or sample_id")),
            (Some(_), Some(_)) => {
                return Err(invalid(
                    "part",
                    "give either its name or sample_id, not both",
                ));
            }
        };
        let new = NewOrder {
            sample_id: 0,
            recipe_id: recipe.id,
            specification_id,
            lot: order.lot.clone(),
            external_id: order.external_id.clone(),
            operator_name: order.operator_name.clone(),
            note: order.note.clone(),
        };
        Ok((part, new))
    }

    /// Number of orders that wait.
    pub(in crate::lab) async fn waiting_orders(&self) -> Result<usize, LabError> {
        let counts = self.store().order_counts().await?;
        let waiting = counts
            .iter()
            .find(|(state, _)| *state == OrderState::Waiting);
        Ok(waiting.map_or(0, |(_, n)| *n as usize))
    }

    /// Moves a waiting order to a place among the waiting ones, from 1.
    ///
    /// # Errors
    /// An order that does not wait, or a store error.
    pub async fn move_order(&self, id: i64, to: u32) -> Result<QueueOrder, LabError> {
        if to == 0 {
            return Err(invalid("to", "must be at least 1, the next one"));
        }
        let moved = self.store().place_order(id, to as usize).await?;
        self.record_order(format!("order {id} moved to place {to}"), None)
            .await;
        Ok(moved)
    }

    /// Removes a waiting or failed order; it stays on record.
    ///
    /// # Errors
    /// An order in another state, or a store error.
    pub async fn remove_order(&self, id: i64) -> Result<QueueOrder, LabError> {
        let (store, change) = (self.store(), OrderChange::Removed);
        let removed = store.change_order(id, change, None, &self.who).await?;
        self.record_order(format!("order {id} removed"), removed.scan_id)
            .await;
        Ok(removed)
    }

    /// Lets a failed order wait again, as the next one.
    ///
    /// # Errors
    /// An order that has not failed, or a store error.
    pub async fn retry_order(&self, id: i64) -> Result<QueueOrder, LabError> {
        let (store, change) = (self.store(), OrderChange::Retried);
        store.change_order(id, change, None, &self.who).await?;
        let order = store.place_order(id, 1).await?;
        self.record_order(format!("order {id} waits again"), order.scan_id)
            .await;
        Ok(order)
    }
}

/// The sample of a part that the store does not know.
fn new_part(name: &str, recipe: &Recipe) -> Result<NewSample, LabError> {
    let Some(material) = recipe.material else {
        return Err(invalid(
            "part",
            format!(
                "there is no part `{name}`, and recipe `{}` states no material; add the part, or [material] to the recipe",
                recipe.name
            ),
        ));
    };
    let sample = NewSample {
        name: name.to_owned(),
        material: material.into(),
        note: None,
        simulated: None,
    };
    match sample.fault() {
        Some((_, problem)) => Err(invalid("part", problem)),
        None => Ok(sample),
    }
}

/// Names the order that is wrong.
fn at_place(place: usize, error: LabError) -> LabError {
    match error {
        LabError::Invalid { field, problem } => {
            invalid(format!("orders[{place}].{field}"), problem)
        }
        LabError::Store(crate::store::StoreError::NotFound { noun, id }) => invalid(
            format!("orders[{place}].sample_id"),
            format!("there is no {noun} {id}"),
        ),
        other => other,
    }
}
