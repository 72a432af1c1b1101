//! One simulated controller at one address, with the axes connected to it.
//!
//! [`Unit::execute`] runs one command for the whole controller (axis 0) or for one of its axes (1,
//! 2 …). The state of each axis is in its [`Device`]; this module combines their replies. A command
//! for all axes runs on one after the other and ends at the first refusal.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::device::settings::{GET_SETTINGS_MAX, is_of_the_axis};
use super::device::{CommandResult, Device, Reject, Scope};
use super::world::World;
use crate::bench::AxisName;
use crate::bench::wire::zaber::{Activity, WORD_BYTES_MAX};
use crate::bench::wire::zaber_flags::Flag;

/// One controller.
#[derive(Debug)]
pub(super) struct Unit {
    axes: Vec<Device>,
}

impl Unit {
    /// Makes a controller that was just powered up, with these axes in the order of their numbers.
    /// Address and serial number are those of the first axis.
    pub fn new(world: &Arc<World>, axes: &[AxisName]) -> Self {
        let mut axes: Vec<Device> = axes
            .iter()
            .map(|axis| Device::new(Arc::clone(world), *axis))
            .collect();
        let first = axes.first().map(|first| first.settings.clone());
        for device in &mut axes {
            if let Some(first) = &first {
                device.settings.address = first.address;
                device.settings.serial = first.serial;
                device.settings.device_id = first.device_id;
            }
        }
        Unit { axes }
    }

    fn first(&self) -> &Device {
        &self.axes[0]
    }

    pub fn address(&self) -> u8 {
        self.first().settings.address
    }

    pub fn set_address(&mut self, address: u8) {
        for device in &mut self.axes {
            device.settings.address = address;
        }
    }

    pub fn checksum(&self) -> bool {
        self.first().settings.checksum
    }

    pub fn alerts(&self) -> bool {
        self.first().settings.alert && self.powered()
    }

    /// Whether it has power; without power it neither receives nor sends.
    pub fn powered(&self) -> bool {
        self.axes.iter().all(Device::powered)
    }

    /// The axes in scope; empty for an unknown axis.
    fn scope(&self, axis: u8) -> &[Device] {
        match usize::from(axis) {
            0 => &self.axes,
            n if n <= self.axes.len() => &self.axes[n - 1..n],
            _ => &[],
        }
    }

    /// The axes that a reply describes; all of them for an unknown axis.
    fn described(&self, axis: u8) -> &[Device] {
        match self.scope(axis) {
            [] => &self.axes,
            scope => scope,
        }
    }

    /// Whether any axis in scope moves.
    pub fn activity(&self, axis: u8) -> Activity {
        let mut described = self.described(axis).iter();
        match described.any(|d| d.activity() == Activity::Busy) {
            true => Activity::Busy,
            false => Activity::Idle,
        }
    }

    fn flags(&self, axis: u8) -> BTreeSet<Flag> {
        let all = self.described(axis).iter().flat_map(Device::flags);
        all.copied().collect()
    }

    /// The highest-priority flag raised on any axis in scope.
    pub fn flag(&self, axis: u8) -> Option<Flag> {
        self.flags(axis).first().copied()
    }

    /// Applies what happened since the last call; returns the numbers of the axes whose motion has
    /// ended.
    pub fn refresh(&mut self) -> Vec<u8> {
        let devices = self.axes.iter_mut().zip(1..);
        let ended = devices.filter_map(|(device, number)| device.refresh().then_some(number));
        let ended = ended.collect();
        // The restart of one axis restarts the whole controller.
        if let Some(booted) = self.axes.iter().map(|device| device.booted).max() {
            for device in self.axes.iter_mut().filter(|d| d.booted < booted) {
                device.world.brake(device.axis, None);
                device.boot(booted);
            }
        }
        ended
    }

    /// Runs one command for the whole controller (`axis` 0) or for one axis.
    pub fn execute(&mut self, axis: u8, words: &str) -> CommandResult {
        if self.scope(axis).is_empty() {
            return Err(Reject::BadAxis).into();
        }
        let words: Vec<&str> = words.split_ascii_whitespace().collect();
        if words.iter().any(|w| w.len() > WORD_BYTES_MAX) {
            return Err(Reject::LongWord).into();
        }
        let flags = self.flags(axis);
        let answer = match words.as_slice() {
            ["get", names @ ..] if !names.is_empty() => return self.get(axis, names).into(),
            ["warnings"] => return Ok(listed(&flags)).into(),
            _ => self.execute_each(axis, &words),
        };
        match words.as_slice() {
            ["warnings", "clear"] => Ok(listed(&flags)).into(),
            _ => answer,
        }
    }

    fn execute_each(&mut self, axis: u8, words: &[&str]) -> CommandResult {
        let (scope, devices) = match usize::from(axis) {
            0 => (Scope::Device, &mut self.axes[..]),
            n => (Scope::Axis, &mut self.axes[n - 1..n]),
        };
        let mut answer = None;
        for device in devices {
            let this = device.execute(scope, words);
            if this.data.is_err() {
                return this;
            }
            answer.get_or_insert(this);
        }
        answer.unwrap_or_else(|| Err(Reject::BadAxis).into())
    }

    /// Reads settings at one moment: `get [axis] name [[axis] name …]`. An axis number applies to
    /// the names after it; values are separated by semicolons.
    fn get(&self, axis: u8, words: &[&str]) -> Result<String, Reject> {
        let mut scope = axis;
        let mut values = Vec::new();
        for word in words {
            match word.parse::<u8>() {
                Ok(number) if axis == 0 && number > 0 && !self.scope(number).is_empty() => {
                    scope = number;
                }
                Ok(_) => return Err(Reject::BadAxis),
                Err(_) => values.push(self.value(scope, word)?),
            }
        }
        if values.is_empty() || values.len() > GET_SETTINGS_MAX {
            return Err(Reject::BadData);
        }
        Ok(values.join("; "))
    }

    /// Reads one setting; an axis setting read from the whole controller gives one value per axis.
    fn value(&self, axis: u8, name: &str) -> Result<String, Reject> {
        if (axis, name) == (0, "system.axiscount") {
            return Ok(self.axes.len().to_string());
        }
        if axis == 0 && !is_of_the_axis(name) {
            return self.first().get(Scope::Device, name);
        }
        let values = self.scope(axis).iter().map(|d| d.get(Scope::Axis, name));
        Ok(values.collect::<Result<Vec<_>, _>>()?.join(" "))
    }
}

/// The reply to `warnings`.
fn listed(flags: &BTreeSet<Flag>) -> String {
    let mut list = format!("{:02}", flags.len());
    for flag in flags {
        list.push_str(&format!(" {flag}"));
    }
    list
}
