/* Entries as a sum of two numbers of single precision: `high` is the entry rounded, `low` what is
   missing, so that both have 48 digits of its 53. */

#include "widen.h"

/* Adds an entry to one that is the sum of two of single precision. */
static inline void add_split(float* high, float* low, double value)
{
  const double sum = (double)*high + (double)*low + value;
  const float rounded = (float)sum;
  *high = rounded;
  *low = (float)(sum - (double)rounded);
}

/* Adds eight entries in a row. */
INLINE void add_eight(float* high, float* low, double8 values)
{
  const double8 sum = widened8(*(const float8*)high) + widened8(*(const float8*)low) + values;
  const float8 rounded = rounded8(sum);
  *(float8*)high = rounded;
  *(float8*)low = rounded8(sum - widened8(rounded));
}
