/* The example of tensor/tensor.h, run. */
#include "tensor/tensor.h"

int main(void)
{
#include "example.inc"
    (void)x;
    return 0;
}
