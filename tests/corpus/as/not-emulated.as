; An instruction of an option: known by name, refused when it is reached.
; stops: E0111 main 2
; after: before = 1
.PROGRAM main()
  before=1
  GUNON 1,50
.END
