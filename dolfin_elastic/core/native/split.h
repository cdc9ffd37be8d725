/* Entries as a sum of two numbers of single precision: `high` is the entry rounded, `low` what is
   missing, so that both have 48 digits of its 53. */

/* Adds an entry to one that is the sum of two of single precision. */
static inline void add_split(float* high, float* low, double value)
{
  const double sum = (double)*high + (double)*low + value;
  const float rounded = (float)sum;
  *high = rounded;
  *low = (float)(sum - (double)rounded);
}

typedef float floats __attribute__((vector_size(32), aligned(4)));
typedef double doubles __attribute__((vector_size(64), aligned(8)));

/* Adds eight entries in a row. */
static inline __attribute__((always_inline)) void add_eight(float* high, float* low, doubles values)
{
  const doubles sum = __builtin_convertvector(*(const floats*)high, doubles)
                      + __builtin_convertvector(*(const floats*)low, doubles) + values;
  const floats rounded = __builtin_convertvector(sum, floats);
  *(floats*)high = rounded;
  *(floats*)low
      = __builtin_convertvector(sum - __builtin_convertvector(rounded, doubles), floats);
}
