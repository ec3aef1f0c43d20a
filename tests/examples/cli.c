/* The example of cli/cli.h, compiled. */
#include "cli/cli.h"

#include "example.inc"

int main(void) { return hg_find("command", "info") == NULL; }
