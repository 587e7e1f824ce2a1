//! Poses in cells of the likelihood field's table.
use cotorra_numbers::Draws;

/// A pose in the table's frame, in cells; the border counts.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Place {
    pub column: f32,
    pub row: f32,
    pub heading: f32,
}

impl Place {
    /// Returns a random place near this one, with these standard deviations of column and row, and of heading.
    pub fn moved(self, way: f32, turn: f32, random: &mut Draws) -> Self {
        Self {
            column: self.column + way * random.bell_f32(),
            row: self.row + way * random.bell_f32(),
            heading: self.heading + turn * random.bell_f32(),
        }
    }
}

/// Places as a structure of arrays.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places {
    pub column: Vec<f32>,
    pub row: Vec<f32>,
    pub heading: Vec<f32>,
}

impl Places {
    pub fn len(&self) -> usize {
        self.heading.len()
    }

    pub fn clear(&mut self) {
        [&mut self.column, &mut self.row, &mut self.heading].into_iter().for_each(Vec::clear);
    }

    pub fn push(&mut self, place: Place) {
        self.column.push(place.column);
        self.row.push(place.row);
        self.heading.push(place.heading);
    }

    pub fn at(&self, nth: usize) -> Place {
        Place { column: self.column[nth], row: self.row[nth], heading: self.heading[nth] }
    }
}
