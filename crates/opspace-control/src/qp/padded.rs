//! Products with small dense matrices whose columns are padded by zeros to a multiple of four.
//!
//! A matrix is a slice of its columns. The length of the columns is that of the vector beside it, the number of columns
//! that of the coefficients. Sums are split into four, so that the compiler can use SIMD. Columns of 8 and 16 numbers, as
//! for joints and their bounds, stay in registers.

/// Columns have a multiple of this length.
const LANES: usize = 4;
/// Length of the columns for which each product has code of its own.
const SHORT: usize = 8;

/// Returns the length of a padded column of `n` numbers.
pub(crate) fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// Returns a buffer whose memory has been written to, so that its first use in a control cycle does not wait for the
/// operating system. A number that is read before it is set shows as NaN.
pub(crate) fn buffer(length: usize) -> Vec<f64> {
    vec![f64::NAN; length]
}

/// Copies `from` into the longer `to` and fills the rest of it with zeros.
#[inline]
pub(crate) fn copy_padded(from: &[f64], to: &mut [f64]) {
    let (head, tail) = to.split_at_mut(from.len());
    head.copy_from_slice(from);
    tail.fill(0.0);
}

/// Returns aᵀ b of padded vectors.
#[inline]
pub(crate) fn dot_padded(a: &[f64], b: &[f64]) -> f64 {
    let ((a, _), (b, _)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3])
}

/// Returns |v| of a padded vector.
#[inline]
pub(crate) fn norm_padded(v: &[f64]) -> f64 {
    dot_padded(v, v).sqrt()
}

/// Adds A c to `sum`.
#[inline]
pub(crate) fn add_product(columns: &[f64], coefficients: &[f64], sum: &mut [f64]) {
    if let Ok(short) = <&mut [f64; SHORT]>::try_from(&mut *sum) {
        return add_product_of(columns, coefficients, short);
    }
    if let Ok(long) = <&mut [f64; 2 * SHORT]>::try_from(&mut *sum) {
        return add_product_of(columns, coefficients, long);
    }
    for (column, c) in columns.chunks_exact(sum.len().max(1)).zip(coefficients) {
        sum.iter_mut().zip(column).for_each(|(sum, a)| *sum += c * a);
    }
}

/// Adds A c to `sum`, for columns of known length.
#[inline]
fn add_product_of<const N: usize>(columns: &[f64], coefficients: &[f64], sum: &mut [f64; N]) {
    let mut whole = *sum;
    for (column, c) in columns.as_chunks::<N>().0.iter().zip(coefficients) {
        whole.iter_mut().zip(column).for_each(|(sum, a)| *sum += c * a);
    }
    *sum = whole;
}

/// Writes Aᵀ x into `products`, as long as A has columns.
#[inline]
pub(crate) fn transposed_product(columns: &[f64], x: &[f64], products: &mut [f64]) {
    if let Ok(short) = <&[f64; SHORT]>::try_from(x) {
        for (product, column) in products.iter_mut().zip(columns.as_chunks::<SHORT>().0) {
            *product = dot_padded(column, short);
        }
        return;
    }
    for (product, column) in products.iter_mut().zip(columns.chunks_exact(x.len().max(1))) {
        *product = dot_padded(column, x);
    }
}

/// Adds x cᵀ to A.
#[inline]
pub(crate) fn add_outer_product(columns: &mut [f64], x: &[f64], coefficients: &[f64]) {
    if let Ok(short) = <&[f64; SHORT]>::try_from(x) {
        for (column, c) in columns.as_chunks_mut::<SHORT>().0.iter_mut().zip(coefficients) {
            column.iter_mut().zip(short).for_each(|(a, x)| *a += c * x);
        }
        return;
    }
    for (column, c) in columns.chunks_exact_mut(x.len().max(1)).zip(coefficients) {
        column.iter_mut().zip(x).for_each(|(a, x)| *a += c * x);
    }
}
