from ffl.cli import main

main()
