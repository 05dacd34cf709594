;;; anmech: programs in C that are compiled in a session, kept for later ones, and run on numbers.
;;;
;;; What has been compiled is kept among Maxima's own objects, with its source, by a name that depends on that and on
;;; the machine, for its processor's own instructions are made use of.  What nobody has run for a month is removed.
;;;
;;; Numbers pass through files of whole numbers of 64 bits, none negative, which all Lisps write and read fast.  A
;;; double is two of them: its mantissa; and 2048 more than the power of 2, times two, and one more if it is negative.
;;; Their octets stand in an order that depends on the Lisp, which the first number, 1, tells.
;;;
;;; Entry points: MAKE-C-PROGRAM, RUN-COMPILED, WRITE-DOUBLE, READ-DOUBLE.

(in-package :anmech)
(needs "session/processes" "session/texts" "session/whole_files" "arithmetic/checksums")

(defparameter *c-compiler* "gcc")
(defparameter *days-kept* 30)

(defun folder-of-programs ()
  (format nil "~a/anmech-programs" (string-right-trim "/" (namestring maxima::$maxima_objdir))))

(defun compiled-c (lines)
  "The path of the program that LINES are the source of; nil where its compilation was interrupted, which is noted."
  (let* ((checksum (checksum-text (reduce (lambda (checksum line) (extended-checksum line checksum)) lines
                                          :initial-value 0)))
         (stem (format nil "~a/~a-~a" (folder-of-programs) checksum (maxima::$anmech_host_word)))
         (source (format nil "~a.c" (passing-name stem))))
    (handler-case (ensure-directories-exist stem)
      (error () (complain-of-files stem)))
    (unwind-protect
         (progn
           (unless (write-whole-file source (teller-of lines)) (complain-of-files stem))
           (case (ends-well (compiling-script source stem) (format nil "~a.cut" source))
             (:interrupted nil)
             ((nil) (complain-of-compiler source))
             (t stem)))
      (mapc #'remove-file (list source (errors-of source) (made-of source))))))

(defun errors-of (source) (format nil "~a.errors" source))

(defun made-of (source) (format nil "~a.made" source))

(defun compiling-script (source stem)
  "Commands that make STEM, unless it is there and comes of the same SOURCE; both come by a passing name."
  (format nil "
    stem=~a; source=~a; made=~a
    if [ -f \"$stem.c\" ] && [ -f \"$stem\" ] && [ -x \"$stem\" ] && cmp -s \"$source\" \"$stem.c\"; then
      touch \"$stem\" \"$stem.c\"; exit 0
    fi
    for native in -march=native ''; do
      if ~a -O3 $native -ffp-contract=off -fno-math-errno -o \"$made\" \"$source\" -lm 2> ~a && [ -f \"$made\" ]; then
        for place in \"$stem\" \"$stem.c\"; do [ ! -d \"$place\" ] || rm -rf \"$place\"; done
        mv -f \"$made\" \"$stem\" && mv -f \"$source\" \"$stem.c\" || exit 1
        find ~a -type f -mtime +~d -exec rm -f {} + 2> /dev/null
        exit 0
      fi
    done
    exit 1"
          (shell-word stem) (shell-word source) (shell-word (made-of source)) *c-compiler*
          (shell-word (errors-of source)) (shell-word (folder-of-programs)) *days-kept*))

(defun complain-of-compiler (source)
  (unless (maxima::$anmech_succeeds (format nil "command -v ~a > /dev/null" *c-compiler*))
    (complain "there is no C compiler ~a; install it (on Debian and Ubuntu: apt-get install gcc libc6-dev)"
              *c-compiler*))
  (complain "~a has not compiled a program: ~a" *c-compiler*
            (or (first (lines-of-file (errors-of source))) "it has said nothing")))

(defun folder-of (file) (subseq file 0 (position #\/ file :from-end t)))

(defun complain-of-files (stem)
  (complain "cannot write to ~a: is the disk full, or read-only?" (folder-of stem)))

(defstruct c-program
  source       ; a function that gives its lines
  (path nil))  ; as soon as it is known

(defun place-of-program (program)
  "The path of PROGRAM, which is compiled if need be; nil where that was interrupted."
  (let ((path (c-program-path program)))
    (if (and path (probe-file path))
        path
        (setf (c-program-path program) (compiled-c (funcall (the function (c-program-source program))))))))

(defun run-compiled (program write read length)
  "What the function READ gives of the stream of whole numbers, LENGTH of them, that PROGRAM has written; WRITE is a
function of the stream that it has read.  Nil where it was interrupted, which is noted.  A program that does not do that
was damaged, and is compiled anew, once."
  (loop for again in '(nil t)
        do (let* ((path (or (place-of-program program) (return nil))) (result (run-c path write read length)))
             (unless (eq result :failed) (return result))
             (when again
               (complain "the program ~a does not run here, or its files cannot be written to ~a" path
                         maxima::$maxima_tempdir))
             (remove-file path)
             (setf (c-program-path program) nil))))

(defun run-c (program write read length)
  "The same, or :failed, of a PROGRAM."
  (let* ((stem (passing-name (format nil "~a/anmech" (string-right-trim "/" maxima::$maxima_tempdir))))
         (input (format nil "~a.in" stem)) (output (format nil "~a.out" stem)))
    (flet ((with-stream (file direction function)
             (handler-case (with-open-file (stream file :direction direction :element-type '(unsigned-byte 64))
                             (funcall (the function function) stream))
               ((or stream-error file-error) () (complain-of-files stem)))))
      (unwind-protect
           (progn
             (with-stream input :output (lambda (stream) (write-byte 1 stream) (funcall write stream)))
             (case (ends-well (format nil "~a < ~a > ~a 2> /dev/null" (shell-word program) (shell-word input)
                                      (shell-word output))
                              (format nil "~a.cut" stem))
               (:interrupted nil)
               ((nil) :failed)
               (t (with-stream output :input
                    (lambda (stream)
                      (if (and (= (file-length stream) (1+ length)) (eql 1 (read-byte stream)))
                          (funcall read stream)
                          :failed))))))
        (mapc #'remove-file (list input output))))))

(defparameter *exponent-offset* 2048)

(defun write-double (number stream)
  (declare (double-float number))
  (multiple-value-bind (mantissa exponent sign) (integer-decode-float number)
    (declare (fixnum exponent))
    (write-byte mantissa stream)
    (write-byte (+ (* 2 (+ exponent *exponent-offset*)) (if (minusp sign) 1 0)) stream)))

(defun read-double (stream)
  "A double that is 0 or has all its digits."
  (let* ((mantissa (read-byte stream)) (rest (read-byte stream)))
    (declare (fixnum mantissa rest))
    (scale-float (if (logtest 1 rest) (- (float mantissa 1d0)) (float mantissa 1d0))
                 (- (ash rest -1) *exponent-offset*))))
